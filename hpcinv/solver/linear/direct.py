"""Factorization by MUMPS: L D Lᵀ of a symmetric tangent, L U of others.

Forward tangents of loads with a potential are symmetric, tangents of inverse problems mostly are not. Each is tested by
two products with a random vector, whose cost is negligible beside a factorization.
"""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from petsc4py import PETSc

from hpcinv.model.spaces import Unknowns
from hpcinv.parallel.petsc_vectors import norm
from hpcinv.solver.linear.configuration import Configuration
from hpcinv.solver.linear.convergence_test import Refinement
from hpcinv.solver.linear.ordering import order_by_nodes
from hpcinv.solver.petsc_options import Value

FEW_RANKS = 8
"""Ranks up to which a root factorized by one of them costs little, and its inertia is worth it for the certificate."""
ROUNDING = 1e-13  # asymmetry by rounding errors in the assembly; loads without a potential cause far more
_NO_MEMORY = frozenset({-8, -9, -11, -13, -14, -15, -17, -18, -19, -20})  # INFOG(1), MUMPS users' guide, ch. 8


class Direct(Configuration):
    """Configuration of the direct solver, MUMPS.

    Args:
        unknowns: those of the tangent, whose nodes are ordered; without them the unknowns themselves are.
        symmetric: whether to factorize symmetric tangents by L D Lᵀ; else L U is used for all.
        minimum_fill: whether to order by approximate minimum fill; else MUMPS chooses METIS.
    """

    name = "direct"
    exact: ClassVar[bool] = True
    has_analysis = True
    asymmetry = ROUNDING
    """Relative, up to which L D Lᵀ is used."""
    test: Refinement

    def __init__(self, unknowns: Unknowns | None = None, *, symmetric: bool = True, minimum_fill: bool = False) -> None:
        super().__init__(Refinement())
        self._unknowns = unknowns
        self._may_be_symmetric, self._minimum_fill = symmetric, minimum_fill
        self._probe: tuple[PETSc.Vec, PETSc.Vec, PETSc.Vec] | None = None

    @property
    def options(self) -> Mapping[str, Value]:
        return {
            "ksp_type": "preonly",
            "pc_type": "lu",
            "pc_factor_mat_solver_type": "mumps",
            "mat_mumps_icntl_33": 1,  # the determinant, whose sign changes at limit points
            "mat_mumps_icntl_14": 50,  # room for pivoting, which nearly incompressible tangents need
            **({"mat_mumps_icntl_7": 2} if self._minimum_fill else {}),
        }

    def prepare(self, ksp: PETSc.KSP, matrix: PETSc.Mat) -> None:
        if self._may_be_symmetric:
            self._choose_type(ksp, matrix)
        if self._unknowns is not None and is_mumps(ksp.pc):
            ksp.pc.setFactorSetUpSolverType()
            order_by_nodes(ksp.pc.getFactorMatrix(), self._unknowns)

    def _choose_type(self, ksp: PETSc.KSP, matrix: PETSc.Mat) -> None:
        option: Any = PETSc.Mat.Option.SYMMETRIC  # whatever its stub says
        if (asymmetry := self._asymmetry_of(matrix)) <= self.asymmetry:
            matrix.setOption(option, asymmetry <= ROUNDING)
            self._set_type(ksp, PETSc.PC.Type.CHOLESKY)
            ksp.pc.setFactorSetUpSolverType()
            factors = ksp.pc.getFactorMatrix()
            factors.setMumpsIcntl(24, 1)  # null pivots are found instead of divided by
            if matrix.comm.size <= FEW_RANKS:
                factors.setMumpsIcntl(13, 1)  # no ScaLAPACK for the root, which hides the signs of its pivots
        else:  # later tangents will not be symmetric either
            self._may_be_symmetric = False
            matrix.setOption(option, False)
            self._set_type(ksp, PETSc.PC.Type.LU)

    def _set_type(self, ksp: PETSc.KSP, kind: str) -> None:
        pc = ksp.pc
        if pc.getType() != kind:
            pc.setType(kind)
            pc.setFactorSolverType("mumps")

    def must_refactorize(self, ksp: PETSc.KSP) -> bool:
        """Return whether L D Lᵀ found the tangent singular; L U, whose failures are clearer, is used from then on."""
        if ksp.pc.getType() != PETSc.PC.Type.CHOLESKY or not is_mumps(ksp.pc):
            return False
        self._may_be_symmetric = not ksp.pc.getFactorMatrix().getMumpsInfog(28)
        if not self._may_be_symmetric:
            self._set_type(ksp, PETSc.PC.Type.LU)
        return not self._may_be_symmetric

    def _asymmetry_of(self, matrix: PETSc.Mat) -> float:
        if self._probe is None:
            x = matrix.createVecRight()
            x.setRandom()
            self._probe = x, x.duplicate(), x.duplicate()
        x, y, z = self._probe
        matrix.mult(x, y)
        matrix.multTranspose(x, z)
        z.axpy(-1.0, y)
        size = norm(y)
        return norm(z) / size if size else 0.0

    def sign_of_determinant(self, ksp: PETSc.KSP) -> int:
        if not is_mumps(ksp.pc):
            return 0
        mantissa = ksp.pc.getFactorMatrix().getMumpsRinfog(12)
        return (mantissa > 0) - (mantissa < 0)

    def lacked_memory(self, ksp: PETSc.KSP) -> bool:
        if not is_mumps(ksp.pc) or ksp.pc.getFactorMatrix().getMumpsInfog(1) not in _NO_MEMORY:
            return False
        # MUMPS postpones pivots that are not numbers until its workspace is full.
        size: Any = ksp.getOperators()[1].norm(PETSc.NormType.FROBENIUS)
        return math.isfinite(size)

    def destroy(self) -> None:
        super().destroy()
        for vector in self._probe or ():
            vector.destroy()


def is_mumps(pc: PETSc.PC) -> bool:
    return pc.getType() in (PETSc.PC.Type.LU, PETSc.PC.Type.CHOLESKY) and pc.getFactorSolverType() == "mumps"
