"""Gaps of two surfaces at their nodes, along the mean normals there.

Mean gaps around each node (`Jump`) may be positive although the surfaces overlap at the node itself. Bodies that do not
overlap need a gap at each node of either surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from petsc4py import PETSc

from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.interfaces.entries import matrix_of_entries
from hpcinv.model.interfaces.facets import Facets, gathered
from hpcinv.model.interfaces.one_body import OneBody
from hpcinv.model.interfaces.segments import OPPOSITE, seen_points, tangents_of

type _Rows = tuple[Floats, Floats, Floats, Ints, Floats]


class NodeGaps:
    """Gaps at nodes of surfaces, along the normals there; construction is collective.

    Args:
        rows: of each surface, for this rank's share of its nodes: gaps (n,), places (n, 3), normals (n, 3), global
            numbers of the unknowns (n, k, 3) by which the gaps change, and their weights (n, k) along the normals.
        owned: number of owned unknowns.

    Attributes:
        gaps: along the normals (scaled), (n,), on all ranks; negative where the surfaces overlap.
        points: places (scaled) of these nodes, (n, 3).
    """

    def __init__(self, rows: Sequence[_Rows], owned: int, comm: Any) -> None:
        self._comm = comm
        self._gaps, self._points, normals, columns, values = (np.concatenate(part) for part in zip(*rows, strict=True))
        count = len(self._gaps)
        start = comm.exscan(count) or 0
        self.gaps: Floats = np.concatenate(comm.allgather(self._gaps))
        self.points: Floats = np.concatenate(comm.allgather(self._points))
        rows_of_entries = np.broadcast_to(start + np.arange(count)[:, None, None], columns.shape)
        entries = values[:, :, None] * normals[:, None, :]
        sizes = (count, PETSc.DETERMINE), (owned, PETSc.DETERMINE)
        self._matrix = matrix_of_entries(comm, *sizes, (rows_of_entries, columns), entries)
        self._left = self._matrix.createVecLeft()

    @classmethod
    def of_surfaces(cls, first: Facets, second: Facets, owned: int, comm: Any, one_body: OneBody | None = None) -> Self:
        """Return the gaps at the nodes of two surfaces, where the other one is seen along the normal.

        Args:
            first: facets of the first surface on this rank.
            second: facets of the second surface on all ranks.
            one_body: surfaces that belong to the same body.
        """
        everywhere = gathered(first, comm)
        rows = [_rows(everywhere, second, comm, one_body), _rows(second, everywhere, comm, one_body, is_reversed=True)]
        return cls(rows, owned, comm)

    def rates(self, direction: PETSc.Vec) -> Floats:
        """Return rates (n,) of the gaps where the nodes move along a direction of the unknowns; collective."""
        self._matrix.mult(direction, self._left)
        return np.concatenate(self._comm.allgather(np.array(self._left.array)))

    def destroy(self) -> None:
        """Free PETSc objects."""
        self._matrix.destroy()
        self._left.destroy()


def _rows(first: Facets, second: Facets, comm: Any, one_body: OneBody | None, *, is_reversed: bool = False) -> _Rows:
    """Return gaps, places and normals of this rank's share of the nodes of a surface, with unknowns and weights."""
    from scipy.spatial import cKDTree

    names, place = np.unique(first.nodes, return_index=True)
    normals = np.zeros((len(names), 3))
    numbers = np.searchsorted(names, first.nodes)
    sizes = first.radii[:, None, None] ** 2
    np.add.at(normals, numbers, np.broadcast_to(sizes * first.middles[1][:, None], (*first.nodes.shape, 3)))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    mine = slice(comm.rank, None, comm.size)
    names, place, normals = names[mine], place[mine], normals[mine]
    points, unknowns = first.points.reshape(-1, 3)[place], first.unknowns.reshape(-1, 3)[place]
    tree, largest = cKDTree(second.middles[0]), float(second.radii.max(initial=0.0))
    nearest = tree.query(points)[0] if one_body is None else one_body.sight
    near = tree.query_ball_point(points, nearest + largest)
    i = np.repeat(np.arange(len(points)), [len(found) for found in near])
    j = np.concatenate([np.zeros(0, dtype=np.int64), *(np.asarray(found, dtype=np.int64) for found in near)])
    faces = np.einsum("ni,ni->n", normals[i], second.middles[1][j]) < OPPOSITE
    kept = faces & ~(second.nodes[j] == names[i][:, None]).any(axis=1)
    if one_body is not None:
        facets = place[i] // first.nodes.shape[1]
        kept &= one_body.may_meet(j, facets) if is_reversed else one_body.may_meet(facets, j)
    i, j = i[kept], j[kept]
    there, y, _, is_there = seen_points(second, j, points[i], tangents_of(normals[i]), np.zeros((len(i), 2)))
    gaps = np.einsum("ni,ni->n", y - points[i], normals[i])
    depths = first.radii[place // first.nodes.shape[1]][i] + second.radii[j]
    good = np.flatnonzero(is_there & (gaps > -depths))
    good = good[np.lexsort((np.abs(gaps[good]), i[good]))]
    _, nearest_ones = np.unique(i[good], return_index=True)  # of several facets the nearest one
    chosen = good[nearest_ones]
    i, j = i[chosen], j[chosen]
    columns = np.concatenate([unknowns[i][:, None], second.unknowns[j]], axis=1)
    values = np.concatenate([np.full((len(i), 1), -1.0), second.kind.values(there[chosen])[0]], axis=1)
    return gaps[chosen], points[i], normals[i], columns, values
