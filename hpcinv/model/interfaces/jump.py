"""Jumps between two surfaces, weighted by basis functions of the first one: constant sums of the unknowns on both.

For each function ``N_i`` of the first surface the jump of a field is ``∫ N_i (v₂ - v₁) dA``, over the segments where
the second surface faces the first (mortar method, Puso & Laursen, 2004, doi:10.1016/j.cma.2003.10.010). The functions
sum up to 1: a constant pressure gives both bodies the exact nodal forces, and they are equal and opposite.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.interfaces.entries import matrix_of_entries
from hpcinv.model.interfaces.facets import Facets
from hpcinv.model.interfaces.segments import Segments

_TINY = 1e-9
"""Share of the largest area of a function below which it is left out. Raised, rims of an interface are free."""


class Jump:
    """Jumps for the functions of the first surface at ``names``; construction is collective.

    Args:
        names: sorted global numbers of the nodes that have a function; all ranks have the same.
        corners: whether functions are of degree 1, at the corners of facets; else of the degree of the displacement.
        first: facets of the first surface on this rank, with their ``segments``.
        second: facets of the second surface on all ranks.

    Attributes:
        areas: ``∫ |N_i| dA`` over the segments, (n,); 0 of functions that are left out.
        normals: mean unit normals of the first surface, (n, 3).
        vectors: means of the jump of the places, (n, 3), scaled; 0 of functions that are left out.
        gaps: means of the gap along the normals, (n,), scaled; 0 of functions that are left out.
        area: of all segments.
    """

    def __init__(
        self, names: Ints, *, corners: bool, first: Facets, second: Facets, segments: Segments, comm: MPI.Intracomm
    ) -> None:
        count, self._comm = len(names), comm
        i, j, weights = segments.first, segments.second, segments.weights
        shapes = first.kind.values(segments.first_places)[0]
        functions = first.kind.corner_values(segments.first_places) if corners else shapes
        opposite = second.kind.values(segments.second_places)[0]
        places = np.searchsorted(names, first.nodes[:, : functions.shape[1]])[i]
        weighted = weights[:, None] * functions
        sums = np.zeros((count, 8))
        there = segments.rigid_points + np.einsum("nk,nki->ni", opposite, second.points[j])
        jumps = there - np.einsum("nk,nki->ni", shapes, first.points[i])
        values = np.concatenate(
            [
                np.abs(weighted)[:, :, None],
                np.abs(weighted)[:, :, None] * segments.normals[:, None],
                weighted[:, :, None] * jumps[:, None],
                weighted[:, :, None],
            ],
            axis=2,
        )
        np.add.at(sums, places, values)
        comm.Allreduce(MPI.IN_PLACE, sums, MPI.SUM)
        self.areas: Floats = np.where(sums[:, 0] > _TINY * sums[:, 0].max(initial=0.0), sums[:, 0], 0.0)
        self.area = float(sums[:, 7].sum())
        sizes = np.linalg.norm(sums[:, 1:4], axis=1, keepdims=True)
        self.normals: Floats = sums[:, 1:4] / np.where(sizes > 0, sizes, 1.0)
        self._inverse_areas = np.where(self.areas > 0, 1 / np.where(self.areas > 0, self.areas, 1.0), 0.0)
        self.vectors: Floats = sums[:, 4:7] * self._inverse_areas[:, None]
        self.gaps: Floats = np.einsum("ni,ni->n", self.normals, sums[:, 4:7]) * self._inverse_areas
        starts = segments.starts
        parts = [
            _summed(places[starts], np.add.reduceat(weighted[:, :, None] * shapes[:, None], starts), unknowns[starts])
            for weighted, shapes, unknowns in (
                (-weighted, shapes, first.unknowns[i]),
                (weighted, opposite, second.unknowns[j]),
            )
        ]
        self._rows, self._unknowns, self._weights = (np.concatenate(part) for part in zip(*parts, strict=True))

    def normal_matrix(self, owned: int, *, means: bool) -> PETSc.Mat:
        """Return the matrix (functions, unknowns) of the jumps along the normals; collective.

        Args:
            owned: number of owned unknowns.
            means: whether jumps are divided by their areas.
        """
        values = self._scaled(means)[:, None] * self.normals[self._rows]
        rows = np.repeat(self._rows, 3)
        return self._matrix(rows, self._unknowns.ravel(), values.ravel(), len(self.areas), owned)

    def vector_matrix(self, owned: int, *, means: bool) -> PETSc.Mat:
        """Return the matrix (functions × 3, unknowns) of the components of the jumps, as `normal_matrix`."""
        rows = 3 * self._rows[:, None] + np.arange(3)
        values = np.repeat(self._scaled(means), 3)
        return self._matrix(rows.ravel(), self._unknowns.ravel(), values, 3 * len(self.areas), owned)

    def has_pattern_of(self, other: Jump) -> bool:
        """Return whether both are sums of the same unknowns; collective."""
        same = np.array_equal(self._rows, other._rows) and np.array_equal(self._unknowns, other._unknowns)
        return bool(self._comm.allreduce(same, op=MPI.LAND))

    def incidence(self) -> Ints:
        """Return functions and the unknowns (k, 4) of the nodes on which each depends, of all ranks; collective."""
        own = np.unique(np.column_stack([self._rows, self._unknowns]), axis=0)
        return np.concatenate(self._comm.allgather(own))

    def _scaled(self, means: bool) -> Floats:
        scaled: Floats = self._weights * (self._inverse_areas[self._rows] if means else 1.0)
        return scaled

    def _matrix(self, rows: Ints, columns: Ints, values: Floats, count: int, owned: int) -> PETSc.Mat:
        sizes = (PETSc.DECIDE, count), (owned, PETSc.DETERMINE)
        return matrix_of_entries(self._comm, *sizes, (rows, columns), values)


def _summed(places: Ints, values: Floats, unknowns: Ints) -> tuple[Ints, Ints, Floats]:
    """Return sums of values (pairs, functions, nodes) by function and node: functions, unknowns (n, 3) and sums."""
    pairs, functions, nodes = values.shape
    rows = np.broadcast_to(places[:, :, None], values.shape).ravel()
    columns = np.broadcast_to(unknowns[:, None], (pairs, functions, nodes, 3)).reshape(-1, 3)
    width = int(columns[:, 0].max(initial=0)) + 1
    _, first, place = np.unique(rows * width + columns[:, 0], return_index=True, return_inverse=True)
    sums = np.zeros(len(first))
    np.add.at(sums, place.ravel(), values.ravel())
    return rows[first], columns[first], sums
