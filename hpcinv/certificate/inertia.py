"""Factors L D Lᵀ of a symmetric matrix, and its inertia: the signs of its eigenvalues (Sylvester)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc


@dataclass(frozen=True)
class Inertia:
    """Numbers of eigenvalues of the symmetric part, by sign; ``asymmetry`` is ``‖K - Kᵀ‖/2‖K‖`` (Frobenius)."""

    negative: int
    zero: int
    positive: int
    asymmetry: float


_OPTIONS = {
    "mat_mumps_icntl_13": 1,  # no ScaLAPACK on the root, where negative pivots are not counted
    "mat_mumps_icntl_24": 1,  # detect null pivots
    "mat_mumps_icntl_14": 50,
}


class SymmetricFactors:
    """Factors ``½(K + Kᵀ) = L D Lᵀ`` by MUMPS; all methods are collective.

    Attributes:
        inertia: number of signs in ``D``.
    """

    def __init__(self, pc: PETSc.PC, symmetric: PETSc.Mat, asymmetry: float) -> None:
        self._pc, self._symmetric = pc, symmetric
        negative, zero, positive = pc.getFactorMatrix().getInertia()
        self.inertia = Inertia(int(negative), int(zero), int(positive), asymmetry)

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve ``½(K + Kᵀ) x = b``."""
        self._pc.apply(b, x)

    def destroy(self) -> None:
        """Free PETSc objects."""
        self._pc.destroy()
        self._symmetric.destroy()


def factorize_symmetric(matrix: PETSc.Mat) -> SymmetricFactors | None:
    """Factorize the symmetric part of a matrix; collective.

    ``None`` if that fails, or if the matrix has entries that are not finite, of which MUMPS makes zero pivots.
    """
    symmetric = matrix.transpose(PETSc.Mat())
    symmetric.aypx(-1.0, matrix)  # K - Kᵀ
    norms: list[Any] = [m.norm(PETSc.NormType.FROBENIUS) for m in (symmetric, matrix)]
    if not all(math.isfinite(norm) for norm in norms):
        symmetric.destroy()
        return None
    symmetric.axpy(-2.0, matrix)  # -(K + Kᵀ)
    symmetric.scale(-0.5)
    option: Any = PETSc.Mat.Option.SYMMETRIC  # its stub has the wrong type
    symmetric.setOption(option, True)
    database, prefix = PETSc.Options("inertia_"), "inertia_"
    for name, value in _OPTIONS.items():
        database.setValue(name, value)
    pc = PETSc.PC().create(matrix.comm)
    try:
        pc.setOptionsPrefix(prefix)
        pc.setOperators(symmetric)
        pc.setType(PETSc.PC.Type.CHOLESKY)
        pc.setFactorSolverType("mumps")
        pc.setFromOptions()
        pc.setUp()
        reason: Any = pc.getFailedReason()
    finally:
        for name in _OPTIONS:
            database.delValue(name)
    if reason != PETSc.PC.FailedReason.NOERROR:
        pc.destroy()
        symmetric.destroy()
        return None
    return SymmetricFactors(pc, symmetric, norms[0] / (2 * norms[1]))


def inertia(matrix: PETSc.Mat) -> Inertia | None:
    """Return the inertia of the symmetric part of a matrix, ``None`` if it cannot be factorized; collective."""
    factors = factorize_symmetric(matrix)
    if factors is None:
        return None
    factors.destroy()
    return factors.inertia
