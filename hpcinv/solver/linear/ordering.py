"""Ordering of nodes instead of unknowns: MUMPS's analysis is on a graph a third or a quarter in size.

All unknowns of a node have the same neighbours, so that the ordering is as good.
"""

import ctypes
from functools import cache
from typing import Any

import numpy as np
from petsc4py import PETSc

from hpcinv.model.spaces import Unknowns


def order_by_nodes(factors: PETSc.Mat, unknowns: Unknowns) -> None:
    """Let the analysis for factors by MUMPS, which has not been made yet, order the nodes of some spaces; collective.

    PETSc does that itself where there are no pressures: by the block size of the matrix. One without
    ``MatMumpsSetBlk`` orders the unknowns of the mixed form.
    """
    if unknowns.p is None or (function := _petsc_function()) is None or factors.getMumpsIcntl(15):
        return
    variables, starts = (np.ascontiguousarray(numbers + 1, dtype=PETSc.IntType) for numbers in unknowns.nodes)
    integer = ctypes.c_int64 if np.dtype(PETSc.IntType).itemsize == 8 else ctypes.c_int32
    arrays = (ctypes.c_void_p(numbers.ctypes.data) for numbers in (variables, starts))
    if error := function(ctypes.c_void_p(factors.handle), integer(len(starts) - 1), *arrays):
        raise PETSc.Error(error)


@cache
def _petsc_function() -> Any:
    """PETSc's function, which petsc4py does not have."""
    return getattr(ctypes.CDLL(PETSc.__file__), "MatMumpsSetBlk", None)
