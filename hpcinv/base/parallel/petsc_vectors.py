"""Inner products and norms of PETSc vectors as floats."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from petsc4py import PETSc


def dot(a: PETSc.Vec, b: PETSc.Vec) -> float:
    """``a·b`` over the unknowns of all ranks."""
    return float(a.dot(b))


def norm(a: PETSc.Vec) -> float:
    """``|a|`` over the unknowns of all ranks."""
    length = a.norm()
    assert isinstance(length, float)  # PETSc gives two for NORM_1_AND_2 only
    return length
