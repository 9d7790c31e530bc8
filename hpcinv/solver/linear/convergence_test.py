"""Convergence tests of Krylov solutions that serve as corrections: by the change of the solution, not by the residual.

A correction needs no more digits than Newton's method gains, and on a chunky body two of them take few iterations. The
residual does not measure them: on a slender body it is small long before the soft motions are right. The solution is
therefore compared with an earlier one whenever the residual has fallen by a certain factor. If its error
halves from one comparison to the next, the remaining error is less than the last change.

With factors of the matrix, or of a similar one, an iteration gains so much that the solution is looked at after each:
changes that shrink by a factor q leave an error of q/(1-q) of the last one.
"""

import math
from collections.abc import Sequence
from typing import Any

from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import norm

_PRECISE = 1e-10  # relative residual, or error, of solutions that are not corrections
_EXACT = 1e-15  # relative residual of rounding errors


class Settling:
    """Convergence test for PETSc's KSP, in addition to the tolerances of the KSP.

    Attributes:
        rough: whether a larger error is accepted, since an outer iteration corrects it.
        precise: whether only the residual counts, down to 1e-10.
        left: number of iterations left to all solutions until it is set again.
        most: number of iterations of one solution that is not precise.
    """

    first = 1e-2  # relative residual of the first comparison
    ratio = 0.3  # of the residuals of successive comparisons
    change = 0.03  # relative change of the solution between comparisons at which it has converged
    rough_first, rough_change = 0.05, 0.1  # first and change of rough solutions

    def __init__(self) -> None:
        self.precise, self.rough = False, False
        self.left = self.most = math.inf
        self._vectors: Sequence[PETSc.Vec] = ()
        self._start, self._next, self._has_compared = 0.0, 0.0, False

    def __call__(self, ksp: PETSc.KSP, iteration: int, residual: float) -> Any:  # an int, whatever the stub says
        reasons = PETSc.KSP.ConvergedReason
        relative, absolute, _, limit = ksp.getTolerances()
        if iteration == 0:
            first = self.rough_first if self.rough else self.first
            self._start, self._next, self._has_compared = residual, first * residual, False
        else:
            self.left -= 1
        if not math.isfinite(residual):
            return reasons.DIVERGED_NANORINF
        if residual <= absolute:
            return reasons.CONVERGED_ATOL
        if residual <= (min(relative, _PRECISE) if self.precise else relative) * self._start:
            return reasons.CONVERGED_RTOL
        if iteration >= limit or self.left <= 0 or (iteration >= self.most and not self.precise):
            return reasons.DIVERGED_MAX_IT
        if not self.precise and residual <= self._next:
            self._next = self.ratio * residual
            if self._change(ksp) <= (self.rough_change if self.rough else self.change):
                return reasons.CONVERGED_STEP_LENGTH
        return reasons.CONVERGED_ITERATING

    def _change(self, ksp: PETSc.KSP) -> float:
        """Return the relative change of the solution since the last comparison; the first one changes all of it."""
        if not self._vectors:
            x = ksp.getSolution()
            self._vectors = x.duplicate(), x.duplicate()
        previous, now = self._vectors
        ksp.buildSolution(now)
        previous.aypx(-1.0, now)
        size = norm(now)
        change = norm(previous) / size if self._has_compared and size > 0 else 1.0
        self._vectors, self._has_compared = (now, previous), True
        return change

    def destroy(self) -> None:
        """Free PETSc objects."""
        for vector in self._vectors:
            vector.destroy()


class Refinement(Settling):
    """Convergence test for solutions with rounded factors of the matrix, or with kept factors of an earlier one.

    Attributes:
        error: relative error, and relative residual, of a correction that has converged; ten times that if rough.
        patience: number of iterations that is worth a factorization.
        is_kept: whether the factors are an earlier matrix's.
        gave_up: whether the last solution ended because new factors would have been cheaper.
    """

    error = 0.01
    share = 0.6  # of `patience` that a solution with kept factors may take

    def __init__(self) -> None:
        super().__init__()
        self.patience = 0.0
        self.is_kept, self.gave_up = False, False
        self._changes = 1.0, 1.0  # the last two

    def __call__(self, ksp: PETSc.KSP, iteration: int, residual: float) -> Any:
        reasons = PETSc.KSP.ConvergedReason
        _, absolute, _, limit = ksp.getTolerances()
        if not math.isfinite(residual):
            return reasons.DIVERGED_NANORINF
        if iteration == 0:
            self._start, self._has_compared, self.gave_up = residual, False, False
            self._changes = 1.0, 1.0
            return reasons.CONVERGED_ATOL if residual <= absolute else reasons.CONVERGED_ITERATING
        self.left -= 1
        relative, tolerance = residual / self._start, _PRECISE if self.precise else self.error
        if relative <= _EXACT or residual <= absolute:
            return reasons.CONVERGED_RTOL
        if self.rough and not self.precise:
            if not self.is_kept:
                return reasons.CONVERGED_ITS
            tolerance *= 10
        last_change, change = self._changes[0], self._change(ksp)
        rate = math.sqrt(change / last_change) if iteration > 2 else change
        self._changes = self._changes[1], change
        if relative <= tolerance and rate < 1 and change * rate / (1 - rate) <= tolerance:
            return reasons.CONVERGED_STEP_LENGTH
        if self.is_kept and iteration > 2 and self._expected(iteration, relative) > self.share * self.patience:
            self.gave_up = True
            return reasons.CONVERGED_ITS
        return reasons.DIVERGED_MAX_IT if iteration >= limit or self.left <= 0 else reasons.CONVERGED_ITERATING

    def _expected(self, iteration: int, relative: float) -> float:
        """Return the number of iterations to a correction, if residuals shrink as they did on average."""
        if relative >= 1:
            return math.inf
        return max(iteration + 1.0, iteration * math.log(self.error) / math.log(relative))
