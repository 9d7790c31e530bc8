"""Preconditioner for displacements and pressures: the right factor of the block factorization of the tangent."""

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from petsc4py import PETSc

from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh.source import Floats

_MASS_ITERATIONS = 4  # of conjugate gradients; two take 10 % more Krylov iterations, six as many


class WithoutPressures:
    """Context of a matrix ``[[A, 0], [0, 0]]`` that multiplies with the tangent, for vectors without pressures."""

    def __init__(self, tangent: PETSc.Mat, pressures: LocalIndices) -> None:
        self._tangent, self._pressures = tangent, pressures

    def mult(self, _matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        self._tangent.mult(x, y)
        y.array[self._pressures] = 0.0

    def multTranspose(self, _matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        self._tangent.multTranspose(x, y)
        y.array[self._pressures] = 0.0


class BlockTriangular:
    """Context of ``[[A, Bᵀ], [0, -M]]⁻¹``; its set-up is collective.

    A fixed number of conjugate-gradient iterations solves for the pressures. By the diagonal of M alone, a cube of
    29,114 unknowns took 46 Krylov iterations to a residual of 1e-6 instead of 31.

    Args:
        tangent: with all rows.
        pressures: local numbers of the owned pressures.
        mass: M at these.
        set_levels: sets up a preconditioner of A, by an operator without pressures.
        prefix: of the options of that preconditioner.
    """

    def __init__(
        self,
        tangent: PETSc.Mat,
        pressures: LocalIndices,
        mass: PETSc.Mat,
        set_levels: Callable[[PETSc.PC, PETSc.Mat, PETSc.Mat], None],
        prefix: str,
    ) -> None:
        self._tangent, self._pressures = tangent, pressures
        self._mass_solver = PETSc.KSP().create(mass.comm)
        self._mass_solver.setOperators(mass)
        self._mass_solver.setType(PETSc.KSP.Type.CG)
        self._mass_solver.pc.setType(PETSc.PC.Type.JACOBI)
        no_norm: Any = PETSc.KSP.NormType.NONE  # an int, whatever its stub says
        self._mass_solver.setNormType(no_norm)
        self._mass_solver.setTolerances(max_it=_MASS_ITERATIONS)
        self._mass_vectors: tuple[PETSc.Vec, PETSc.Vec] = mass.createVecRight(), mass.createVecLeft()
        self._operator = PETSc.Mat().createPython(
            tangent.getSizes(), WithoutPressures(tangent, pressures), tangent.comm
        )
        self._operator.setUp()
        self.displacements = PETSc.PC().create(tangent.comm)
        self.displacements.setOptionsPrefix(prefix)
        self.displacements.setOperators(self._operator)
        self.displacements.setFromOptions()
        set_levels(self.displacements, self._operator, tangent)
        self._right: PETSc.Vec = tangent.createVecRight()
        self._left: PETSc.Vec = tangent.createVecLeft()

    def setUp(self, pc: PETSc.PC) -> None:
        """Report a failure of the preconditioner of A."""
        pc.setFailedReason(cast(Any, self.displacements.getFailedReason()))

    def apply(self, _pc: PETSc.PC, residual: PETSc.Vec, correction: PETSc.Vec) -> None:
        x, b = self._mass_vectors
        b.array[:] = -cast(Floats, residual.array_r)[self._pressures]
        self._mass_solver.solve(b, x)
        pressures = np.array(x.array)
        self._right.set(0.0)
        self._right.array[self._pressures] = pressures
        self._tangent.mult(self._right, self._left)
        self._left.aypx(-1.0, residual)
        self._left.array[self._pressures] = 0.0
        self.displacements.apply(self._left, correction)
        correction.array[self._pressures] = pressures

    def applyTranspose(self, _pc: PETSc.PC, residual: PETSc.Vec, correction: PETSc.Vec) -> None:
        x, b = self._mass_vectors
        residual.copy(self._left)
        self._left.array[self._pressures] = 0.0
        self.displacements.applyTranspose(self._left, self._right)
        self._right.array[self._pressures] = 0.0
        self._tangent.multTranspose(self._right, self._left)
        b.array[:] = cast(Floats, self._left.array_r)[self._pressures] - cast(Floats, residual.array_r)[self._pressures]
        self._mass_solver.solve(b, x)
        self._right.copy(correction)
        correction.array[self._pressures] = x.array

    def reset(self, _pc: PETSc.PC) -> None:
        """Free PETSc objects."""
        mass_parts = self._mass_solver, *self._mass_vectors
        for part in (self.displacements, self._operator, self._right, self._left, *mass_parts):
            part.destroy()
