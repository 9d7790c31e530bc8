"""Solutions with the symmetric part of a tangent by FGMRES and multigrid, where factors are not affordable."""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_calls import set_up, solve
from hpcinv.base.parallel.petsc_vectors import norm
from hpcinv.model.weak_form import WeakForm
from hpcinv.solver.linear.iterative import Iterative
from hpcinv.solver.petsc_options import SolverOptions
from hpcinv.trust.stability.inertia import asymmetry_of, symmetric_part


class MultigridSolver:
    """Linear solver for ``½(K + Kᵀ) x = b``, set up for the present state and mesh; all methods are collective.

    Args:
        matrix: a tangent of the weak form, or another matrix of the same structure, which must not change afterwards.
        weak_form: its state and mesh must be the matrix's.

    Attributes:
        matrix: the symmetric part.
        asymmetry: as of `Inertia`.
        pressure_mass: diagonal of the scaled mass matrix of the owned pressures.
    """

    def __init__(self, matrix: PETSc.Mat, weak_form: WeakForm) -> None:
        self.unknowns = weak_form.unknowns
        self.asymmetry = asymmetry_of(matrix)
        symmetric = symmetric_part(matrix) if self.asymmetry else matrix
        self._configuration = Iterative(weak_form)
        self._options = SolverOptions({})
        self._options.use(self._configuration.options)
        self._ksp = PETSc.KSP().create(matrix.comm)
        self._ksp.setOptionsPrefix(SolverOptions.prefix)
        self._ksp.setOperators(symmetric)
        if symmetric is not matrix:
            symmetric.destroy()
        self.matrix: PETSc.Mat = self._ksp.getOperators()[0]  # stays if its other owners destroy it
        self._ksp.setFromOptions()
        self._configuration.prepare(self._ksp, self.matrix)
        set_up(self._ksp)
        self._ksp.setUpOnBlocks()
        self.pressure_mass = self._configuration.pressure_scale()
        self._options.remove()

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Solve roughly, beginning with zero; return whether that succeeded."""
        return self.improve(b, x, start_from_zero=True)

    def improve(
        self, b: PETSc.Vec, x: PETSc.Vec, *, precise: bool = False, residual: float = 0.0, start_from_zero: bool = False
    ) -> bool:
        """Solve, beginning with ``x``; return whether that succeeded.

        Args:
            precise: whether to solve to rounding errors.
            residual: norm of the residual at which a rough solution ends.
        """
        self._configuration.set_accuracy(precise=precise)
        self._configuration.set_rough(rough=not precise)
        self._ksp.setTolerances(atol=0.0 if precise else residual)
        self._ksp.setInitialGuessNonzero(not start_from_zero)
        solve(self._ksp, b, x)
        reason: Any = self._ksp.getConvergedReason()
        return reason >= 0 and bool(np.isfinite(norm(x)))

    def destroy(self) -> None:
        """Free PETSc objects."""
        self._ksp.destroy()
        self.matrix.destroy()
        self._configuration.destroy()
