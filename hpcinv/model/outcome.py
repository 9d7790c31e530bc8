"""Outcomes of one solve at a fixed load factor."""

from __future__ import annotations

import enum


class Outcome(enum.Enum):
    """How one solve at a fixed load factor ended: what a user is told, and what to try."""

    CONVERGED = "converged", ""
    ROUND_OFF = "converged as far as rounding errors allow", ""
    DIVERGED = (
        "Newton's corrections grew",
        "Try a smaller solver.initial_step, or a finer mesh where the body bends most. Do the supports hold the body"
        " against every rigid motion?",
    )
    INVERTED = (
        "an element would turn inside out (det F ≤ 0)",
        "Try a smaller solver.initial_step; else look for poor elements there, or for a load that cannot be carried.",
    )
    OUTSIDE_LAW = (
        "the material would be strained beyond what its law is defined for",
        "Check its limit (such as jm of gent) and the loads, or take a law without one.",
    )
    VOLUME_CHANGED = (
        "the incompressible material would halve or double its volume somewhere",
        "Perhaps no such shape exists at this load; else refine the mesh there, or try a smaller solver.initial_step.",
    )
    NOT_FINITE = (
        "the residual is not finite: a law left its domain, or an element turned inside out",
        "Try a smaller solver.initial_step, and check the units of loads and material.",
    )
    ITERATION_LIMIT = (
        "Newton's method took too many iterations",
        "Raise solver.maximum_iterations, or try a smaller solver.initial_step.",
    )
    LINEAR_SOLVER = (
        "the linear solver failed: the tangent is singular",
        "Do the supports hold the body against every rigid motion, and leave an incompressible one some free surface?"
        " If so, look at solver.petsc.",
    )
    KRYLOV_LIMIT = (
        "the iterative linear solver did not converge within the iterations that it may take",
        "Take more memory or nodes, or a coarser mesh, so that the tangent can be factorized instead. Do the supports"
        " hold the body firmly?",
    )
    LINE_SEARCH = (
        "the line search found no acceptable step",
        "Take the default line search (remove snes_linesearch_type), or a smaller solver.initial_step.",
    )
    FORWARD_FAILED = (
        "a forward problem of the fixed-point method was not solved",
        "Its own outcome stands before this one. Try 'method: direct', which solves none, or a smaller"
        " fixed_point.relaxation.",
    )
    FIXED_POINT_LIMIT = (
        "the fixed-point method took too many iterations",
        "Try 'method: direct', anderson or aitken, or raise fixed_point.maximum_iterations.",
    )
    FIXED_POINT_DIVERGED = (
        "the fixed-point method comes no closer to the given shape",
        "Try 'method: direct', anderson or aitken, or a smaller fixed_point.relaxation. Is fixed_point.tolerance above"
        " rounding errors?",
    )
    LIMIT_POINT = (
        "the load reaches a limit point here",
        "Lower the load.",
    )
    ANOTHER_PATH = (
        "the solution found there does not belong to the path from the unloaded body",
        "Try a smaller solver.initial_step.",
    )
    STEP_LIMIT = (
        "the path was followed for as many steps as it may",
        "With 'strategy: arc-length' raise solver.maximum_steps.",
    )
    INTERRUPTED = "interrupted by a signal", ""

    def __init__(self, text: str, advice: str) -> None:
        self.text = text
        self.advice = advice

    @property
    def accepted(self) -> bool:
        return self in (Outcome.CONVERGED, Outcome.ROUND_OFF)
