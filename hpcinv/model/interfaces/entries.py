"""Distributed matrices of entries by row and column."""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc

from hpcinv.mesh.source import Floats, Ints

DIFFERENT_PATTERN: Any = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN  # its stub has the wrong type

type Size = tuple[int, int]
"""local and global number of rows or columns; one of them may be PETSc's to decide"""


def matrix_of_entries(comm: Any, rows: Size, columns: Size, places: tuple[Ints, Ints], values: Floats) -> PETSc.Mat:
    """Return a new matrix with the sums of the ranks' entries; collective.

    Args:
        places: global rows and columns of the entries of this rank, and ``values``; all in arrays of one shape.
    """
    matrix = PETSc.Mat().create(comm)
    matrix.setSizes((rows, columns))
    matrix.setType(PETSc.Mat.Type.AIJ)
    i, j = (np.ascontiguousarray(part).ravel().astype(PETSc.IntType) for part in places)
    numbers: Any = (i, j)  # arrays will do; the stubs have lists
    given: Any = np.ascontiguousarray(values).ravel()
    matrix.setPreallocationCOO(*numbers)
    matrix.setValuesCOO(given)
    return matrix
