"""Unknowns of a long thin shell: middle, director and quadratic part of a column of nodes.

The tangent of the nodes has entries of size ``E A/t``, whose rounding errors hide the stiffness in bending. A motion of
the middle does not stretch the thickness. In these unknowns that is exact: the derivative of its functions along the
third reference axis is zero, not a sum of large terms. With the tangent ``K`` of the nodes, whose displacements are
``x = T y``, the matrix is ``Tᵀ K T``, made from transformed functions. Residual and solution stay at the nodes, since
rounding errors of the residual strain the shell by 1e-16 L/t only.
"""

from __future__ import annotations

from typing import Any

import dolfinx.fem.petsc as fem_petsc
import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import MeshError
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.spaces import Unknowns
from hpcinv.model.supports import Supports

_HEIGHTS = np.array([[-1.0, 1.0, 1.0], [0.0, 1.0, 0.0], [1.0, 1.0, 1.0]])
"""displacements of a column's three nodes, row by row, that a unit of its director, middle or quadratic part makes"""


class DirectorUnknowns:
    """Change of unknowns in one layer of hexahedra of degree 2, whose third reference axis goes through the layer.

    The new unknowns of a column have the places of its nodes: the director ``(u₊ - u₋)/2``, the middle ``u₀``, and the
    quadratic part ``(u₊ + u₋)/2 - u₀``. All methods are collective.

    Raises:
        MeshError: on all ranks, if a support holds one face alone, or along a normal.
    """

    def __init__(self, unknowns: Unknowns, supports: Supports) -> None:
        mesh, space = unknowns.mesh, unknowns.space
        self._numbers, self._bs = space.dofmap.index_map, space.dofmap.index_map_bs
        dofs = unknowns.dofs_of_cells()[0][:, _columns()]  # (cells, columns, 3 nodes, components)
        self._triples = np.unique(dofs.transpose(0, 1, 3, 2).reshape(-1, 3), axis=0)
        is_held = np.zeros(self._bs * (self._numbers.size_local + self._numbers.num_ghosts), dtype=bool)
        for condition in supports.conditions:
            is_held[condition.dof_indices()[0]] = True
        low, middle, high = is_held[self._triples].T
        if mesh.comm.allreduce(bool(((low != high) | (low & ~middle)).any()), op=MPI.LOR):
            raise MeshError("supports: a face of a shell this thin is held without its middle", "Hold an edge instead.")
        if supports.sliding is not None:
            raise MeshError(
                f"{supports.slides[0].field}: 'normal' is not possible in a shell this thin",
                "Fix x, y or z, or turn the mesh so that the normal is an axis.",
            )
        self._held = np.flatnonzero(is_held[: self._bs * self._numbers.size_local])
        self._to_nodes, self._from_nodes = (self._matrix(m) for m in (_HEIGHTS, np.linalg.inv(_HEIGHTS)))
        self._given, self._work = self._to_nodes.createVecRight(), self._to_nodes.createVecRight()

    def functions(self, table: Floats) -> Floats:
        """Return values and derivatives (4, points, 27) of the new unknowns' functions for the nodes' functions."""
        columns, transformed = _columns(), np.empty_like(table)
        transformed[..., columns] = table[..., columns] @ _HEIGHTS
        transformed[3][:, columns[:, 1]] = 0.0
        return transformed

    def add(self, matrix: PETSc.Mat, form: fem.Form) -> None:
        """Add a form of the nodes' unknowns to a matrix of the new ones."""
        nodal = fem_petsc.assemble_matrix(form)
        nodal.assemble()
        part = nodal.PtAP(self._to_nodes)
        first = part.getOwnershipRange()[0]
        part.zeroRowsColumns((first + self._held).astype(PETSc.IntType), diag=0.0)
        structure: Any = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN  # its stub has the wrong type
        matrix.axpy(1.0, part, structure)
        nodal.destroy()
        part.destroy()

    def enter(self, b: PETSc.Vec) -> None:
        """Transform forces at the nodes; entries of held unknowns are their displacements."""
        b.copy(self._given)
        self._to_nodes.multTranspose(self._given, b)
        self._from_nodes.mult(self._given, self._work)
        b.array[self._held] = self._work.array[self._held]

    def leave(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Restore the forces that `enter` transformed last, and transform a solution to displacements of the nodes."""
        self._given.copy(b)
        x.copy(self._work)
        self._to_nodes.mult(self._work, x)

    def enter_transposed(self, b: PETSc.Vec) -> None:
        """Transform forces at the nodes for a solve with the transposed matrix."""
        b.copy(self._work)
        self._to_nodes.multTranspose(self._work, b)

    def leave_transposed(self, x: PETSc.Vec) -> None:
        """Transform a solution with the transposed matrix to weights of what `enter` takes at the nodes."""
        x.copy(self._given)
        self._given.array[self._held] = 0.0
        self._to_nodes.mult(self._given, self._work)
        held = x.array[self._held].copy()
        x.set(0.0)
        x.array[self._held] = held
        self._from_nodes.multTranspose(x, self._given)
        self._given.copy(x)
        x.axpy(1.0, self._work)

    def to_nodes(self, x: PETSc.Vec) -> None:
        """Transform a solution to displacements of the nodes."""
        x.copy(self._work)
        self._to_nodes.mult(self._work, x)

    def attach(self, ksp: PETSc.KSP) -> None:
        """Let a solver take forces at the nodes, and return displacements there."""
        ksp.setPreSolve(lambda _, b, x: self.enter(b))
        ksp.setPostSolve(lambda _, b, x: self.leave(b, x))

    def destroy(self) -> None:
        """Free PETSc objects."""
        for part in (self._to_nodes, self._from_nodes, self._given, self._work):
            part.destroy()

    def _matrix(self, column: Floats) -> PETSc.Mat:
        """Return the matrix that multiplies the three unknowns of each column, and leaves pressures as they are."""
        owned = self._bs * self._numbers.size_local
        triples, other = self._triples, np.setdiff1d(np.arange(owned), self._triples)
        rows = np.concatenate([np.repeat(triples, 3, axis=1).ravel(), other])
        columns = np.concatenate([np.tile(triples, 3).ravel(), other])
        values = np.concatenate([np.tile(column.ravel(), len(triples)), np.ones(len(other))])
        kept = (rows < owned) & (values != 0)
        size = owned, self._bs * self._numbers.size_global
        matrix = PETSc.Mat().createAIJ((size, size), comm=self._numbers.comm)
        matrix.setPreallocationCOO(self._global(rows[kept]), self._global(columns[kept]))  # type: ignore[arg-type]
        matrix.setValuesCOO(values[kept])
        return matrix

    def _global(self, dofs: Ints) -> npt.NDArray[Any]:
        nodes = self._numbers.local_to_global((dofs // self._bs).astype(np.int32))
        return np.asarray(self._bs * nodes + dofs % self._bs, dtype=PETSc.IntType)


def _columns() -> Ints:
    """Local nodes (9, 3) of a cell's columns, from the inner to the outer face."""
    places = np.rint(2 * scalar_element("hexahedron", 2).points).astype(np.int64)
    return np.lexsort(places.T[[2, 1, 0]]).reshape(-1, 3)
