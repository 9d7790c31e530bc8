"""Convergence test of Krylov solutions that serve as corrections: by the change of the solution, not by the residual.

A correction needs no more digits than Newton's method gains, and on a chunky body two of them take few iterations. The
residual is no measure of them: on a slender body it is small long before the soft motions are right, to which it is
insensitive. The solution is therefore compared with an earlier one whenever the residual has fallen by a certain
factor. If its error halves from one comparison to the next, the remaining error is less than the last change.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

from hpcinv.parallel.petsc_vectors import norm

if TYPE_CHECKING:
    from collections.abc import Sequence

_PRECISE = 1e-10  # relative residual of solutions that are no corrections


class Settling:
    """Convergence test for PETSc's KSP, in addition to the tolerances of the KSP.

    Attributes:
        precise: whether only the residual counts, down to 1e-10.
        left: number of iterations left to all solutions until it is set again.
    """

    first = 1e-2  # relative residual of the first comparison
    ratio = 0.3  # of the residuals of successive comparisons
    change = 0.03  # relative change of the solution between comparisons at which it has converged

    def __init__(self) -> None:
        self.precise = False
        self.left = math.inf
        self._vectors: Sequence[PETSc.Vec] = ()
        self._start, self._next, self._has_compared = 0.0, 0.0, False

    def __call__(self, ksp: PETSc.KSP, iteration: int, residual: float) -> Any:  # an int, whatever the stub says
        reasons = PETSc.KSP.ConvergedReason
        relative, absolute, _, limit = ksp.getTolerances()
        if iteration == 0:
            self._start, self._next, self._has_compared = residual, self.first * residual, False
        else:
            self.left -= 1
        if not math.isfinite(residual):
            return reasons.DIVERGED_NANORINF
        if residual <= absolute:
            return reasons.CONVERGED_ATOL
        if residual <= (min(relative, _PRECISE) if self.precise else relative) * self._start:
            return reasons.CONVERGED_RTOL
        if iteration >= limit or self.left <= 0:
            return reasons.DIVERGED_MAX_IT
        if not self.precise and residual <= self._next:
            self._next = self.ratio * residual
            if self._has_settled(ksp):
                return reasons.CONVERGED_STEP_LENGTH
        return reasons.CONVERGED_ITERATING

    def _has_settled(self, ksp: PETSc.KSP) -> bool:
        if not self._vectors:
            x = ksp.getSolution()
            self._vectors = x.duplicate(), x.duplicate()
        before, now = self._vectors
        ksp.buildSolution(now)
        before.aypx(-1.0, now)
        settled = self._has_compared and norm(before) <= self.change * norm(now)
        self._vectors, self._has_compared = (now, before), True
        return settled

    def destroy(self) -> None:
        """Free PETSc objects."""
        for vector in self._vectors:
            vector.destroy()
