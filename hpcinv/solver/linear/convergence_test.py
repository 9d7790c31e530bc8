"""When a Krylov solution will do as a correction: once it no longer changes, whatever its residual is.

Digits of a correction beyond those of Newton's own are wasted, and two of them are soon there on a chunky body. The
residual does not tell when: on a slender one it is small long before the soft motions are right, which it hardly knows
of. So the solution itself is looked at whenever the residual has fallen by a certain factor. As long as its error falls
by half from one look to the next, what is left of it is less than the last change.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

from hpcinv.parallel.petsc_vectors import norm

if TYPE_CHECKING:
    from collections.abc import Sequence

_PRECISE = 1e-10  # relative residual where a solution is wanted for its own sake


class Settling:
    """A convergence test for PETSc's KSP; that solver's own tolerances hold as well.

    Attributes:
        precise: whether the residual alone counts, down to 1e-10.
        left: iterations that are left to all solutions until it is set again.
    """

    first = 1e-2  # relative residual of the first look
    ratio = 0.3  # of the residuals of two looks that follow each other
    change = 0.03  # from one look to the next, relative, at which the solution has settled

    def __init__(self) -> None:
        self.precise = False
        self.left = math.inf
        self._vectors: Sequence[PETSc.Vec] = ()
        self._start, self._next, self._has_looked = 0.0, 0.0, False

    def __call__(self, ksp: PETSc.KSP, iteration: int, residual: float) -> Any:  # an int, whatever the stub says
        reasons = PETSc.KSP.ConvergedReason
        relative, absolute, _, limit = ksp.getTolerances()
        if iteration == 0:
            self._start, self._next, self._has_looked = residual, self.first * residual, False
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
        settled = self._has_looked and norm(before) <= self.change * norm(now)
        self._vectors, self._has_looked = (now, before), True
        return settled

    def destroy(self) -> None:
        """Free what PETSc holds."""
        for vector in self._vectors:
            vector.destroy()
