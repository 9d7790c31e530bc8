"""How Newton's method is judged: by its corrections, not by the residual.

On slender and nearly incompressible bodies the residual first rises by orders of magnitude while the corrections
already shrink. Corrections are also what tells how far the solution is: with a contraction ``θ`` of successive
corrections the error left is about ``θ/(1-θ)`` times the last one (Deuflhard, *Newton Methods for Nonlinear Problems*,
2011, doi:10.1007/978-3-642-23899-4).
"""

from __future__ import annotations

import enum
import itertools
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hpcinv.solver.step_measure import Increment


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
    FOLD = (
        "the load turns back here",
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


@dataclass(frozen=True)
class NewtonIteration:
    """One iteration: norms of correction, state and residual (scaled), and whether it had a new tangent."""

    correction: float
    state: float
    residual: float
    new_tangent: bool


@dataclass
class NewtonMonitor:
    """Decides after each correction whether to stop, and whether the next one needs a new tangent.

    Args:
        tolerance: estimated error of the state, relative to its norm, at which a solve ends.
        limit: number of iterations after which it is given up.
        reuse: largest contraction at which a tangent is kept (Shamanskii's method); 0 is full Newton.
        begins_near: whether the first correction can be trusted, small as it may be.
        predicted: length of the step, by the tangent at hand, that has foretold where it begins; 0 if none has.
        inexact: error of a correction itself, relative, as the linear solver leaves it.
        growths_allowed: iterations in which the correction may grow; a solve with more of them has diverged.
    """

    tolerance: float
    limit: int
    reuse: float
    begins_near: bool = False
    predicted: float = 0.0
    inexact: float = 0.0
    growths_allowed: int = 2
    history: list[NewtonIteration] = field(default_factory=list)

    # The first corrections may shrink by chance, far from the solution: a tangent found there must not be kept.
    near = 0.02
    # Where it is known to begin near the solution, a first correction as small as this keeps its tangent.
    next_to = 5e-3
    # Corrections smaller than this that no longer shrink are rounding errors; larger ones are not.
    round_off = 1e-8
    # A correction by a kept tangent that exceeds the one before by more than this is found anew.
    renewal = 1.0
    # A correction that turns or stretches the body more than this leads nowhere, unless it is the first.
    too_far = 10.0

    @property
    def contraction(self) -> float:
        """Ratio of the last two corrections; 1 as long as there is only one."""
        if len(self.history) < 2:
            return 1.0
        before, last = self.history[-2].correction, self.history[-1].correction
        return last / before if before > 0 else 0.0

    @property
    def wants_new_tangent(self) -> bool:
        if not self.history:
            return not (self.predicted and self.reuse)
        last = self.history[-1]
        if len(self.history) == 1 and self.begins_near and last.correction <= self.next_to * last.state:
            return False
        theta = self.contraction
        if len(self.history) == 1 and self.predicted:
            theta = last.correction / self.predicted
        return not (theta <= self.reuse and last.correction <= self.near * last.state)

    def may_take(self, correction: float, state: float) -> bool:
        """Whether to take a correction that a kept tangent gives, or to find it anew, from the same state.

        To know it costs no factorization (Deuflhard's simplified correction).
        """
        if not self.history:
            return correction <= self.reuse * self.predicted and correction <= self.near * state
        return correction <= self.renewal * self.history[-1].correction

    def is_hopeless(self, increment: Increment) -> bool:
        """Whether to give up, by what the next correction would do to the body."""
        is_first = not self.history and not self.predicted
        return not is_first and not (increment.turn <= self.too_far and increment.stretch <= self.too_far)

    def judge(self, iteration: NewtonIteration) -> Outcome | None:
        """Take in one iteration; ``None`` means go on."""
        self.history.append(iteration)
        if not (math.isfinite(iteration.correction) and math.isfinite(iteration.residual)):
            return Outcome.NOT_FINITE
        theta, last, size = max(self.contraction, self.inexact), iteration.correction, iteration.state
        if last == 0.0 or (theta < 1 and last * theta / (1 - theta) <= self.tolerance * size):
            return Outcome.CONVERGED
        if last <= self.round_off * size and theta > 0.5 and iteration.new_tangent and len(self.history) > 1:
            return Outcome.ROUND_OFF
        if len(self.history) >= self.limit:
            return Outcome.ITERATION_LIMIT
        if self._growths() > self.growths_allowed:
            return Outcome.DIVERGED
        return None

    def _growths(self) -> int:
        """Number of iterations in which the correction grew."""
        corrections = [i.correction for i in self.history]
        return sum(after > before for before, after in itertools.pairwise(corrections))
