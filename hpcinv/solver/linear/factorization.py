"""Factorization by MUMPS: L D Lᵀ of a symmetric tangent, L U of others.

Forward tangents of loads with a potential are symmetric, tangents of inverse problems mostly are not. Each is tested by
two products with a random vector, whose cost is negligible against a factorization.
"""

import ctypes
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.left_for_run import available
from hpcinv.base.parallel.petsc_calls import petsc_function
from hpcinv.base.parallel.petsc_vectors import norm
from hpcinv.model.outcome import Outcome
from hpcinv.model.spaces import Unknowns
from hpcinv.solver.linear.configuration import LinearConfiguration
from hpcinv.solver.linear.convergence_test import Refinement
from hpcinv.solver.petsc_options import OptionValue

FEW_RANKS = 8
"""Ranks up to which a root factorized by one of them costs little, and its inertia is worth it for the certificate."""
ROUNDING = 1e-13  # asymmetry by rounding errors in the assembly; loads without a potential cause far more
WORKSPACE = 50
"""Room for pivoting by which MUMPS's estimate is enlarged at first, in percent (ICNTL(14)), which nearly incompressible
tangents need. More of it takes memory; less is found out by a factorization that fails and is repeated."""
_WORKSPACE = "mat_mumps_icntl_14"
# INFOG(1), MUMPS users' guide, ch. 8
_LITTLE_WORKSPACE = frozenset({-8, -9, -11, -12, -14, -15, -17, -20})  # of arrays, or of buffers for messages
_OVERHEAD = 1e8  # bytes; with less, workspaces of tiny bodies are not enlarged, with more they may grow in vain
_NOT_ALLOCATED, _LIMITED = -13, -19


class Direct(LinearConfiguration):
    """Configuration of the direct solver, MUMPS.

    Args:
        unknowns: the tangent's, whose nodes are ordered; without them the unknowns themselves are.
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
    def options(self) -> Mapping[str, OptionValue]:
        return {
            "ksp_type": "preonly",
            "pc_type": "lu",
            "pc_factor_mat_solver_type": "mumps",
            "mat_mumps_icntl_33": 1,  # the determinant, whose sign changes at limit points
            _WORKSPACE: WORKSPACE,
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

    def larger_workspace(self, ksp: PETSc.KSP) -> Mapping[str, OptionValue]:
        matrix = ksp.getOperators()[1]
        if not is_mumps(ksp.pc) or not (percent := larger_workspace(ksp.pc)):
            return {}
        # MUMPS postpones pivots that are not numbers until its workspace is full.
        size: Any = matrix.norm(PETSc.NormType.FROBENIUS)
        return {_WORKSPACE: percent} if math.isfinite(size) else {}

    def failure(self, ksp: PETSc.KSP) -> Outcome:
        code = ksp.pc.getFactorMatrix().getMumpsInfog(1) if is_mumps(ksp.pc) else 0
        size: Any = ksp.getOperators()[1].norm(PETSc.NormType.FROBENIUS)
        if not math.isfinite(size):
            return Outcome.LINEAR_SOLVER
        if code == _LIMITED:
            return Outcome.MEMORY_LIMIT
        return Outcome.NO_MEMORY if code == _NOT_ALLOCATED or code in _LITTLE_WORKSPACE else Outcome.LINEAR_SOLVER

    def destroy(self) -> None:
        super().destroy()
        for vector in self._probe or ():
            vector.destroy()


def is_mumps(pc: PETSc.PC) -> bool:
    return pc.getType() in (PETSc.PC.Type.LU, PETSc.PC.Type.CHOLESKY) and pc.getFactorSolverType() == "mumps"


def larger_workspace(pc: PETSc.PC) -> int:
    """Return twice the workspace (percent) of a factorization that failed for lack of it; collective.

    0 if it did not, if there is no memory for that, or if full factors would fit into the workspace that was too small.
    """
    factors = pc.getFactorMatrix()
    if factors.getMumpsInfog(1) not in _LITTLE_WORKSPACE:
        return 0
    matrix, percent = pc.getOperators()[1], factors.getMumpsIcntl(14)
    estimate = 1e6 * factors.getMumpsInfog(17)  # bytes of all ranks with the present workspace
    larger = 2 * max(percent, WORKSPACE // 2)
    needed = estimate * (100 + larger) / (100 + percent)
    full = 16.0 * matrix.getSize()[0] ** 2 + _OVERHEAD
    comm = matrix.comm.tompi4py()
    return larger if estimate < full and needed <= available(comm) else 0


def order_by_nodes(factors: PETSc.Mat, unknowns: Unknowns) -> None:
    """Let the analysis for factors by MUMPS, which has not been made yet, order the nodes of some spaces; collective.

    PETSc does that itself where there are no pressures: by the block size of the matrix. One without
    ``MatMumpsSetBlk`` orders the unknowns of the mixed form.
    """
    if unknowns.p is None or (function := petsc_function("MatMumpsSetBlk")) is None or factors.getMumpsIcntl(15):
        return
    variables, starts = (np.ascontiguousarray(numbers + 1, dtype=PETSc.IntType) for numbers in unknowns.nodes)
    integer = ctypes.c_int64 if np.dtype(PETSc.IntType).itemsize == 8 else ctypes.c_int32
    arrays = (ctypes.c_void_p(numbers.ctypes.data) for numbers in (variables, starts))
    if error := function(ctypes.c_void_p(factors.handle), integer(len(starts) - 1), *arrays):
        raise PETSc.Error(error)
