"""Transfer between spaces of different degrees on one mesh, by the interpolation of each cell."""

from collections.abc import Iterator

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import la

from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh.source import Floats
from hpcinv.model.spaces import Unknowns

_CELLS = 10_000  # whose values are gathered at once; more take more memory


class Transfer:
    """Interpolation P of unknowns in finer spaces, and its transpose; all methods are collective.

    All matrices of cells are the same, so that P needs less time cell by cell than to be made as a sparse matrix.
    """

    def __init__(self, coarse: Unknowns, finer: Unknowns) -> None:
        self._tables: list[Floats] = [
            basix.compute_interpolation_operator(low.basix_element, high.basix_element)
            for low, high in zip(coarse.scalar_elements, finer.scalar_elements, strict=True)
        ]
        self._coarse_dofs, self._finer_dofs = coarse.dofs_of_cells(), finer.dofs_of_cells()
        self._coarse, self._finer = (_vector(unknowns) for unknowns in (coarse, finer))
        self._owned = tuple(len(unknowns.state.x.petsc_vec.array) for unknowns in (coarse, finer))
        # A residual at an unknown of several cells is divided among them.
        counts = sum(np.bincount(high.ravel(), minlength=len(self._finer.array)) for high in self._finer_dofs)
        self._shares: Floats = 1.0 / np.maximum(counts, 1)

    def interpolate(self, coarse: Floats) -> Floats:
        """Return ``P x`` of owned unknowns."""
        self._coarse.array[: len(coarse)] = coarse
        self._coarse.scatter_forward()
        for table, coarse_rows, finer_rows in self._parts():
            self._finer.array[finer_rows] = table @ self._coarse.array[coarse_rows]
        return np.array(self._finer.array[: self._owned[1]])

    def restrict(self, finer: npt.NDArray[np.floating]) -> Floats:
        """Return ``Pᵀ r`` of owned unknowns."""
        self._coarse.array[:] = 0.0
        self._finer.array[:] = 0.0
        self._finer.array[: len(finer)] = finer * self._shares[: len(finer)]
        for table, coarse_rows, finer_rows in self._parts():
            np.add.at(self._coarse.array, coarse_rows.ravel(), (table.T @ self._finer.array[finer_rows]).ravel())
        self._coarse.scatter_reverse(la.InsertMode.add)
        return np.array(self._coarse.array[: self._owned[0]])

    def _parts(self) -> Iterator[tuple[Floats, LocalIndices, LocalIndices]]:
        """Yield the interpolation of each field, with the coarse and the finer unknowns of some cells at a time."""
        for table, coarse_rows, finer_rows in zip(self._tables, self._coarse_dofs, self._finer_dofs, strict=True):
            for begin in range(0, len(finer_rows), _CELLS):
                cells = slice(begin, begin + _CELLS)
                yield table, coarse_rows[cells], finer_rows[cells]


def _vector(unknowns: Unknowns) -> la.Vector:
    dofmap = unknowns.space.dofmap
    return la.vector(dofmap.index_map, dofmap.index_map_bs)
