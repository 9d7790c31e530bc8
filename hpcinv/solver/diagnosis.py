"""Diagnosis of a failure to reach the full load, from the solves of all strategies."""

import enum
from collections.abc import Sequence

from hpcinv.model.outcome import Outcome
from hpcinv.physics.effects import Direction
from hpcinv.solver.newton import SERIES, Solve


class Diagnosis(enum.Enum):
    """Reasons why the full load was not reached, with message and advice; those named as an `Outcome` explain it."""

    LIMIT_POINT = (
        "the load reaches its maximum on this path (limit point)",
        "Check load, stiffness and units; lower the load, or take {strategy: arc-length, limit_points: 2}.",
    )
    LEAST_LOAD = (
        "the load reaches its minimum on this path (limit point)",
        "The path falls and rises again here. 'limit_points: 0' finds the solution before both limit points.",
    )
    BEYOND_FULL_LOAD = (
        "beyond the first solution at full load, no other was reached",
        "Take 'limit_points: 0' for the first solution, or a finer mesh or smaller steps for another one.",
    )
    NO_UNDEFORMED_SHAPE = (
        "elements of the undeformed shape would invert or collapse",
        "Check load, material and units. If a finer mesh stops here too, no such undeformed shape exists.",
    )
    INVERTED = (
        "an element would turn inside out (det F ≤ 0)",
        "Refine poor elements where the body is squeezed or bends most, or lower the load.",
    )
    VOLUME_CHANGED = (
        "incompressible material would halve or double its volume",
        "Refine the mesh there; if that does not help, the load cannot be carried.",
    )
    LOSS_OF_STABILITY = (
        "the body lost its stability (the determinant changed its sign)",
        "Lower the load, or hold the body better. A small imperfection lets buckling be followed.",
    )
    BRANCHING = (
        "undeformed shapes branch (the determinant changed its sign)",
        "Beyond this load the undeformed shape is not unique. Lower the load.",
    )
    OUTSIDE_LAW = (
        "the strain would leave the range of the material law",
        "Check its limit (such as jm of gent) and the load, or take a law without one.",
    )
    ILL_POSED = (
        "the tangent is singular, even in the unloaded body",
        "Hold the body against rigid motions, leave an incompressible one free surface, check solver.petsc.",
    )
    LINEAR_SOLVER = (
        "the linear solver failed: the tangent is singular",
        "Lower the load, hold the body better, or choose 'solver: {linear: direct}'.",
    )
    KRYLOV_LIMIT = (
        "the iterative linear solver failed; the direct one is excluded",
        "Leave out 'solver: {linear: iterative}', take more memory, or improve poor elements.",
    )
    NO_MEMORY = (
        "there is not enough memory for the factors of the tangent",
        "Take more memory or nodes, a coarser mesh, or 'solver: {linear: iterative}'.",
    )
    MEMORY_LIMIT = (
        Outcome.MEMORY_LIMIT.text,
        "Raise or remove mat_mumps_icntl_23 in solver.petsc, which is MB for each rank.",
    )
    ITERATION_LIMIT = (
        "Newton's method took too many iterations",
        "Raise solver.maximum_iterations, or try a smaller solver.initial_step.",
    )
    STEP_LIMIT = (
        "the path took too many steps",
        "Raise solver.maximum_steps (strategy: arc-length), or lower solver.minimum_step.",
    )
    NOT_FINITE = (
        "the residual is not finite: a stress or a load overflows",
        "Check units of loads and material, and formulas; try a smaller solver.minimum_step.",
    )
    NOT_CONVERGED = (
        "Newton's method does not converge, however small the step",
        "Try a smaller solver.minimum_step, and a finer mesh where the body deforms most.",
    )
    ARC_LENGTH_CUT_SHORT = (
        "Newton's method fails; arc length took too many factorizations",
        "Look for a limit point by 'solver: {strategy: arc-length}', or refine where the body deforms most.",
    )
    PASSED_THROUGH = (Outcome.PASSED_THROUGH.text, Outcome.PASSED_THROUGH.advice)
    CONTACT_LIMIT = (Outcome.CONTACT_LIMIT.text, Outcome.CONTACT_LIMIT.advice)
    FORWARD_FAILED = FIXED_POINT_LIMIT = FIXED_POINT_DIVERGED = (
        "the fixed-point method did not find the shape",
        "Try 'method: direct', which needs no forward solves, or a smaller fixed_point.relaxation.",
    )

    def __init__(self, text: str, advice: str) -> None:
        self.text = text
        self.advice = advice


# Ends of the path for any strategy, which loss of stability does not explain.
_DECISIVE = {
    Diagnosis.CONTACT_LIMIT,
    Diagnosis.PASSED_THROUGH,
    Diagnosis.LIMIT_POINT,
    Diagnosis.KRYLOV_LIMIT,
    Diagnosis.NO_MEMORY,
    Diagnosis.MEMORY_LIMIT,
    Diagnosis.OUTSIDE_LAW,
    Diagnosis.FORWARD_FAILED,
}
_DEGENERATE = {Diagnosis.INVERTED, Diagnosis.VOLUME_CHANGED}
# Strategies whose last outcome is used for the diagnosis, in order of preference. Power series count as load steps.
_PREFERRED = ("arc-length", "load steps")


def diagnose(direction: Direction, solves: Sequence[Solve]) -> Diagnosis:
    """Return the reason why the solves of one direction ended before the full load; the last of them failed."""
    accepted = [solve for solve in solves if solve.outcome.accepted]
    last = max((number for number, solve in enumerate(solves) if solve.outcome.accepted), default=-1)
    if any(solve.outcome is Outcome.PASSED_THROUGH for solve in solves[last + 1 :]):
        return Diagnosis.PASSED_THROUGH
    diagnosis = Diagnosis.__members__.get(_last_outcome(solves).name, Diagnosis.NOT_CONVERGED)
    if diagnosis is Diagnosis.LINEAR_SOLVER and not accepted:
        return Diagnosis.ILL_POSED
    if any(solve.load > 1 for solve in accepted) and diagnosis is not Diagnosis.STEP_LIMIT:
        return _diagnosis_beyond(diagnosis, accepted)
    if diagnosis in _DECISIVE:
        return diagnosis
    if _crossed_singular_point(accepted):
        return Diagnosis.LOSS_OF_STABILITY if direction == "forward" else Diagnosis.BRANCHING
    if diagnosis in _DEGENERATE and direction == "inverse" and accepted:
        return Diagnosis.NO_UNDEFORMED_SHAPE
    if diagnosis is Diagnosis.NOT_CONVERGED and _arc_length_was_cut_short(solves):
        return Diagnosis.ARC_LENGTH_CUT_SHORT
    return diagnosis


def _diagnosis_beyond(diagnosis: Diagnosis, accepted: Sequence[Solve]) -> Diagnosis:
    """Return the diagnosis of a path that went beyond the full load."""
    passed = sum(solve.limit_point for solve in accepted)
    is_minimum = diagnosis is Diagnosis.LIMIT_POINT and passed % 2 == 0
    return Diagnosis.LEAST_LOAD if is_minimum else Diagnosis.BEYOND_FULL_LOAD


def _last_outcome(solves: Sequence[Solve]) -> Outcome:
    """Return the last outcome of the preferred strategy; `Outcome.STEP_LIMIT` only if there is no other."""
    if solves[-1].outcome is Outcome.LIMIT_POINT:
        return Outcome.LIMIT_POINT
    last = {"load steps" if solve.strategy == SERIES else solve.strategy: solve.outcome for solve in solves}
    ends = [last[s] for s in _PREFERRED if s in last and not last[s].accepted] or [solves[-1].outcome]
    return next((end for end in ends if end is not Outcome.STEP_LIMIT), ends[0])


def _arc_length_was_cut_short(solves: Sequence[Solve]) -> bool:
    """Return whether it was a fallback that ended for too much effort."""
    ends = [solve.outcome for solve in solves if solve.strategy == "arc-length"]
    return solves[0].strategy != "arc-length" and ends[-1:] == [Outcome.STEP_LIMIT]


def _crossed_singular_point(accepted: Sequence[Solve]) -> bool:
    """Return whether the tangent's determinant changed its sign between limit points."""
    if any(solve.bifurcation is not None for solve in accepted):
        return True
    sign = 0
    for solve in accepted:
        if solve.limit_point:
            sign = 0
        elif solve.signs:
            if sign and solve.signs[-1] != sign:
                return True
            sign = solve.signs[-1]
    return False
