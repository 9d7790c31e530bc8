"""Factors L D Lᵀ of a symmetric matrix, and its inertia: the signs of its eigenvalues (Sylvester)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_calls import set_up
from hpcinv.base.parallel.petsc_vectors import norm
from hpcinv.model.spaces import Unknowns
from hpcinv.solver.linear.factorization import WORKSPACE, larger_workspace, order_by_nodes
from hpcinv.solver.petsc_options import OptionValue


@dataclass(frozen=True)
class Inertia:
    """Numbers of eigenvalues of the symmetric part, by sign.

    Attributes:
        asymmetry: as of `asymmetry_of`.
    """

    negative: int
    zero: int
    positive: int
    asymmetry: float


_OPTIONS: Mapping[str, OptionValue] = {
    "mat_mumps_icntl_13": 1,  # no ScaLAPACK on the root, where negative pivots are not counted
    "mat_mumps_icntl_24": 1,  # detect null pivots
    "mat_mumps_icntl_14": WORKSPACE,
}
_ROUNDED: Mapping[str, OptionValue] = {"pc_precision": "single"}
_LOW_RANK: Mapping[str, OptionValue] = {"mat_mumps_icntl_35": 2, "mat_mumps_cntl_7": 1e-4}
_MINIMUM_FILL: Mapping[str, OptionValue] = {"mat_mumps_icntl_7": 2}
_ITERATIONS = 30  # of GMRES, which tests rounded and kept factors
_SOLVED = 1e-5  # relative preconditioned residual there
_LEAST = 0.1  # real part of an eigenvalue there
_ASYMMETRY = 1e-12  # relative, of products with a vector, by rounding errors


class SymmetricFactors:
    """Factors ``½(K + Kᵀ) = L D Lᵀ`` by MUMPS; all methods are collective.

    Attributes:
        inertia: number of signs in ``D``.
    """

    def __init__(self, pc: PETSc.PC, asymmetry: float, director: Any) -> None:
        self._pc, self._director = pc, director
        negative, zero, positive = pc.getFactorMatrix().getInertia()
        self.inertia = Inertia(int(negative), int(zero), int(positive), asymmetry)

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Solve ``½(K + Kᵀ) x = b`` for unknowns at the nodes, and return that this succeeded."""
        if self._director is None:
            self._pc.apply(b, x)
            return True
        self._director.enter(b)
        self._pc.apply(b, x)
        self._director.leave(b, x)
        return True

    def destroy(self) -> None:
        """Free PETSc objects."""
        self._pc.destroy()


def factorize_symmetric(
    matrix: PETSc.Mat,
    kept: Sequence[PETSc.PC] = (),
    *,
    rounded: bool = False,
    low_rank: bool = False,
    minimum_fill: bool = False,
    unknowns: Unknowns | None = None,
    director: Any = None,
) -> SymmetricFactors | None:
    """Factorize the symmetric part of a matrix, unless kept factors will do; collective.

    ``None`` if that fails, or if the matrix has entries that are not finite (MUMPS makes zero pivots of them).

    Args:
        kept: factors L D Lᵀ of similar matrices; the first ones that have the inertia of this one are taken.
        rounded: whether factors in single precision will do. They are tested, and made in double precision if their
            inertia might not be the matrix's.
        low_rank: whether blocks of rounded factors are compressed.
        minimum_fill: whether to order by approximate minimum fill; else MUMPS chooses METIS.
        unknowns: the matrix's, whose nodes are ordered; without them the unknowns themselves are.
        director: unknowns of the matrix, if they are not at the nodes.
    """
    asymmetry = asymmetry_of(matrix)
    if not math.isfinite(asymmetry):
        return None
    operator = matrix
    if asymmetry:
        operator = PETSc.Mat().createPython(matrix.getSizes(), _SymmetricPart(matrix), matrix.comm)
    pc = next((factors for factors in kept if _has_inertia_of(factors, operator)), None)
    if operator is not matrix:
        operator.destroy()
    if pc is not None:
        return SymmetricFactors(pc, asymmetry, director)
    symmetric = symmetric_part(matrix) if asymmetry else matrix
    option: Any = PETSc.Mat.Option.SYMMETRIC  # its stub has the wrong type
    symmetric.setOption(option, True)
    options = {**_OPTIONS, **(_MINIMUM_FILL if minimum_fill else {})}
    roundings = [{**_ROUNDED, **_LOW_RANK}, _ROUNDED] if low_rank else [_ROUNDED]
    accepted = _tested_factors(symmetric, options, [*roundings, {}] if rounded else [{}], unknowns)
    if symmetric is not matrix:
        symmetric.destroy()
    return None if accepted is None else SymmetricFactors(accepted, asymmetry, director)


def _tested_factors(
    symmetric: PETSc.Mat,
    options: Mapping[str, OptionValue],
    roundings: Sequence[Mapping[str, OptionValue]],
    unknowns: Unknowns | None,
) -> PETSc.PC | None:
    """Return factors with the first options of rounding that keep the inertia; ``None`` if all fail."""
    for rounding in roundings:
        pc = _factorized(symmetric, {**options, **rounding}, unknowns)
        if pc is not None and (not rounding or _has_inertia_of(pc, symmetric)):
            return pc
        if pc is not None:
            pc.destroy()
    return None


class _SymmetricPart:
    """Products with ``½(K + Kᵀ)`` for a matrix of PETSc's type ``python``."""

    def __init__(self, matrix: PETSc.Mat) -> None:
        self._matrix = matrix

    def mult(self, _: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set ``y = ½(K + Kᵀ) x``."""
        other = y.duplicate()
        self._matrix.mult(x, y)
        self._matrix.multTranspose(x, other)
        y.axpy(1.0, other)
        y.scale(0.5)
        other.destroy()


def asymmetry_of(matrix: PETSc.Mat) -> float:
    """Return ``‖K - Kᵀ‖/2‖K‖`` (Frobenius), estimated by a random vector; 0 for rounding errors; collective.

    It is not a number if K has entries that are none.
    """
    x = matrix.createVecRight()
    x.setRandom()
    x.shift(-0.5)  # of mean 0
    y, z = x.duplicate(), x.duplicate()
    matrix.mult(x, y)
    matrix.multTranspose(x, z)
    z.axpy(-1.0, y)
    difference, size = norm(z), norm(y)
    for vector in (x, y, z):
        vector.destroy()
    if not math.isfinite(size):
        return math.nan
    return difference / (2 * size) if difference > _ASYMMETRY * size else 0.0


def symmetric_part(matrix: PETSc.Mat) -> PETSc.Mat:
    """Return ``½(K + Kᵀ)``, a new matrix; collective."""
    symmetric = matrix.transpose(PETSc.Mat())
    structure: Any = PETSc.Mat.Structure.UNKNOWN_NONZERO_PATTERN  # compared; much faster if it is symmetric
    symmetric.axpy(1.0, matrix, structure)
    symmetric.scale(0.5)
    return symmetric


def _factorized(matrix: PETSc.Mat, options: Mapping[str, OptionValue], unknowns: Unknowns | None) -> PETSc.PC | None:
    """Return factors of a symmetric matrix, ``None`` if MUMPS fails also with more workspace; collective."""
    database, prefix = PETSc.Options("inertia_"), "inertia_"
    for name, value in options.items():
        database.setValue(name, value)
    pc = PETSc.PC().create(matrix.comm)
    try:
        pc.setOptionsPrefix(prefix)
        pc.setOperators(matrix)
        pc.setType(PETSc.PC.Type.CHOLESKY)
        pc.setFactorSolverType("mumps")
        pc.setFromOptions()
        if unknowns is not None:
            pc.setFactorSetUpSolverType()
            order_by_nodes(pc.getFactorMatrix(), unknowns)
        set_up(pc)
        pc.setReusePreconditioner(True)  # the matrix may be assembled again
        reason: Any = pc.getFailedReason()
    finally:
        for name in options:
            database.delValue(name)
    if reason == PETSc.PC.FailedReason.NOERROR:
        return pc
    larger = larger_workspace(pc)
    pc.destroy()
    return _factorized(matrix, {**options, "mat_mumps_icntl_14": larger}, unknowns) if larger else None


def _has_inertia_of(pc: PETSc.PC, matrix: PETSc.Mat) -> bool:
    """Return whether factors M of a matrix K, both symmetric, have its inertia; collective.

    Between them, ``M + t (K - M)`` is singular for some t if ``M⁻¹K`` has a real eigenvalue that is not positive, and
    only then can a sign change. GMRES for ``M⁻¹ b`` with a random b shows the eigenvalues that are far from 1, first of
    all parts of soft motions, which are the largest of it: unless one shows that is not positive, the polynomial
    of GMRES, which is 1 at 0 with positive roots, leaves all of that part in the residual.
    """
    ksp = PETSc.KSP().create(matrix.comm)
    ksp.setType(PETSc.KSP.Type.GMRES)
    ksp.setPC(pc)
    factorized = pc.getOperators()
    ksp.setOperators(matrix)
    ksp.setComputeEigenvalues(True)
    ksp.setGMRESRestart(_ITERATIONS)
    ksp.setTolerances(rtol=_SOLVED, max_it=_ITERATIONS)
    b = matrix.createVecLeft()
    x = b.duplicate()
    b.setRandom()
    ksp.solve(b, x)
    reason: Any = ksp.getConvergedReason()  # an int, whatever its stub says
    has_inertia = reason > 0 and bool((np.asarray(ksp.computeEigenvalues()).real > _LEAST).all())
    pc.setOperators(*factorized)
    for petsc_object in (x, b, ksp):
        petsc_object.destroy()
    return has_inertia


def inertia(matrix: PETSc.Mat) -> Inertia | None:
    """Return the inertia of the symmetric part of a matrix, ``None`` if it cannot be factorized; collective."""
    factors = factorize_symmetric(matrix)
    if factors is None:
        return None
    factors.destroy()
    return factors.inertia
