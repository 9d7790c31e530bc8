"""Outcomes of one solve at a fixed load factor."""

import enum


class Outcome(enum.Enum):
    """Outcome of one solve at a fixed load factor, with its message and, for fixed-point methods, advice."""

    CONVERGED = "converged"
    ROUND_OFF = "converged as far as rounding errors allow"
    DIVERGED = "Newton's corrections grew"
    INVERTED = "an element would turn inside out (det F ≤ 0)"
    OUTSIDE_LAW = "the strain would leave the range of the material law"
    VOLUME_CHANGED = "incompressible material would halve or double its volume"
    TOO_NONLINEAR = "the step is too long for Newton's method"
    NOT_FINITE = "the residual is not finite: a law left its domain, or an element turned inside out"
    ITERATION_LIMIT = "Newton's method took too many iterations"
    LINEAR_SOLVER = "the linear solver failed: the tangent is singular"
    KRYLOV_LIMIT = "the iterative linear solver did not converge within the iterations that it may take"
    NO_MEMORY = "there is not enough memory for the factors of the tangent"
    MEMORY_LIMIT = "the factors of the tangent need more memory than the PETSc options of the job allow"
    LINE_SEARCH = "the line search found no acceptable step"
    FORWARD_FAILED = (
        "a forward problem of the fixed-point method was not solved",
        "Try 'method: direct', which needs no forward solves, or a smaller fixed_point.relaxation.",
    )
    FIXED_POINT_LIMIT = (
        "the fixed-point method took too many iterations",
        "Try 'method: direct', anderson or aitken, or raise fixed_point.maximum_iterations.",
    )
    FIXED_POINT_DIVERGED = (
        "the fixed-point method comes no closer to the given shape",
        "Try 'method: direct', a smaller fixed_point.relaxation, or a larger fixed_point.tolerance.",
    )
    LIMIT_POINT = "the load reaches a limit point here"
    ANOTHER_PATH = "the solution found there does not belong to the path from the unloaded body"
    PASSED_THROUGH = (
        "the surface of the body would pass through an obstacle or another surface",
        "Take smaller steps (solver.minimum_step, solver.steps), or refine the mesh near a thin obstacle.",
    )
    CONTACT_LIMIT = (
        "the pressures of contact do not settle",
        "Raise effects[i].penalty tenfold, or effects[i].penetration; refine the mesh where the body touches.",
    )
    STEP_LIMIT = "the path was followed for as many steps as it may"
    INTERRUPTED = "interrupted by a signal"

    def __init__(self, text: str, advice: str = "") -> None:
        self.text = text
        self.advice = advice

    @property
    def is_final(self) -> bool:
        """True if no shorter step and no other strategy can help."""
        return self in (Outcome.INTERRUPTED, Outcome.KRYLOV_LIMIT, Outcome.NO_MEMORY, Outcome.MEMORY_LIMIT)

    @property
    def accepted(self) -> bool:
        """True if the state is a solution."""
        return self in (Outcome.CONVERGED, Outcome.ROUND_OFF)
