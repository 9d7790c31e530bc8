"""How Newton's method is judged: by its corrections, not by the residual.

On slender and nearly incompressible bodies the residual first rises by orders of magnitude while the corrections
already shrink. Corrections are also what tells how far the solution is: with a contraction ``θ`` of successive
corrections the error left is about ``θ/(1-θ)`` times the last one (Deuflhard, *Newton Methods for Nonlinear Problems*,
2011, doi:10.1007/978-3-642-23899-4).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hpcinv.model.outcome import Outcome

if TYPE_CHECKING:
    from hpcinv.solver.step_measure import Increment


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
