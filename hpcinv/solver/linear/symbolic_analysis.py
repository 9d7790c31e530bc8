"""Operations of a factorization by MUMPS's symbolic analysis, which takes less time than the factorization."""

import ctypes
from functools import cache

from petsc4py import PETSc

from hpcinv.model.spaces import Unknowns
from hpcinv.solver.linear.ordering import order_by_nodes

_MATCHING = 6  # ICNTL(6) permutes columns by values, which are not there yet
_INFO = 32  # numbers of PETSc's ``MatFactorInfo``: more than it has; MUMPS reads none of them


def operations_of(matrix: PETSc.Mat, unknowns: Unknowns) -> float | None:
    """Return the operations of a factorization L U of a matrix with this pattern, ``None`` if not known; collective.

    The values of the matrix are not read.
    """
    function = _petsc_function()
    if function is None or not matrix.assembled:  # matrices of small meshes have their pattern later
        return None
    pc = PETSc.PC().create(matrix.comm)
    try:
        pc.setOperators(matrix)
        pc.setType(PETSc.PC.Type.LU)
        pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
        pc.setFactorSetUpSolverType()
        factors = pc.getFactorMatrix()
        factors.setMumpsIcntl(_MATCHING, 0)
        order_by_nodes(factors, unknowns)
        info = (ctypes.c_double * _INFO)()
        if function(ctypes.c_void_p(factors.handle), ctypes.c_void_p(matrix.handle), None, None, info):
            return None
        return factors.getMumpsRinfog(1) if factors.getMumpsInfog(1) >= 0 else None
    finally:
        pc.destroy()


@cache
def _petsc_function() -> "ctypes._NamedFuncPointer | None":
    """PETSc's function, which petsc4py does not have."""
    return getattr(ctypes.CDLL(PETSc.__file__), "MatLUFactorSymbolic", None)
