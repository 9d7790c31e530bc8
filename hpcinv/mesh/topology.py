"""Facets of a cell array, and integer rows matched as sets of vertices."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from hpcinv.mesh.cells import sub_entities
from hpcinv.mesh.source import Ints


def unique_rows(rows: Ints) -> tuple[Ints, Ints]:
    """Distinct rows, sorted, and the index among them of each given row."""
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    starts = np.ones(len(rows), dtype=bool)
    starts[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    place = np.empty(len(rows), dtype=np.int64)
    place[order] = np.cumsum(starts) - 1
    return ordered[starts], place


def find_rows(rows: Ints, table: Ints) -> Ints:
    """Index of each row in ``table`` (distinct rows), or -1 if ``table`` does not contain it."""
    _, place = unique_rows(np.concatenate([table, rows]))
    where = np.full(len(place), -1, dtype=np.int64)
    where[place[: len(table)]] = np.arange(len(table))
    return where[place[len(table) :]]


def vertex_sets(entities: Ints, local: Ints) -> Ints:
    """Sorted vertices (entities·s, v) of the sub-entities ``local`` (s, v) of every entity, entity by entity."""
    return np.sort(entities[:, local].reshape(-1, local.shape[1]), axis=1)


@dataclass(frozen=True)
class FacetTable:
    """All distinct facets of a mesh: sorted ``vertices`` (f, v), and the number of cells that share each."""

    vertices: Ints
    sharing: Ints
    cell_facets: Ints  # (cells, facets of a cell): rows of ``vertices``

    @classmethod
    def build(cls, kind: str, cells: Ints) -> Self:
        """Table of the facets of ``cells`` (c, vertices)."""
        local = sub_entities(kind, 2)
        vertices, place = unique_rows(vertex_sets(cells, local))
        return cls(vertices, np.bincount(place, minlength=len(vertices)), place.reshape(-1, len(local)))

    def find(self, facets: Ints) -> Ints:
        """Rows for ``facets`` given by their vertices in any order; -1 if it is not a facet of the mesh."""
        return find_rows(np.sort(facets, axis=1), self.vertices)

    def owners(self, facets: Ints) -> Ints:
        """Return a cell and the local number of the facet in it, (n, 2), for each distinct row in ``facets``."""
        is_chosen = np.zeros(len(self.vertices), dtype=bool)
        is_chosen[facets] = True
        owners = np.argwhere(is_chosen[self.cell_facets])
        _, first = np.unique(self.cell_facets[owners[:, 0], owners[:, 1]], return_index=True)
        return owners[first]

    def separates(self, label: Ints) -> npt.NDArray[np.bool_]:
        """Mask (f,) of the facets between two cells of different ``label`` (cells,)."""
        first = np.empty(len(self.vertices), dtype=label.dtype)
        first[self.cell_facets] = label[:, None]
        mask = np.zeros(len(self.vertices), dtype=bool)
        mask[self.cell_facets[first[self.cell_facets] != label[:, None]]] = True
        return mask


def edge_neighbours(ends: Ints, place: Ints) -> tuple[Ints, Ints, Ints]:
    """Return pairs of cells with a common edge, and 1 where their normals agree across it, else -1.

    Args:
        ends: vertices (c, e, 2) of the edges of triangles or quadrilaterals, in Basix' order, which goes around a cell
            forwards and backwards in turn.
        place: number of each of these edges, (c e,).
    """
    edges = ends.shape[1]
    direction = (np.where(ends[:, :, 0] < ends[:, :, 1], 1, -1) * np.where(np.arange(edges) % 2, -1, 1)).ravel()
    order = np.argsort(place, kind="stable").reshape(-1)
    first = np.flatnonzero(place[order][1:] == place[order][:-1])
    a, b = order[first], order[first + 1]
    # Two cells agree if they go along their common edge in opposite directions.
    return a // edges, b // edges, np.where(direction[a] * direction[b] < 0, 1, -1)


def neighbour_signs(one: Ints, other: Ints, agree: Ints, count: int) -> tuple[Ints, Ints]:
    """Return a sign and the number of the connected part for each of ``count`` cells.

    Neighbours have the same sign where ``agree`` is 1, and opposite signs where it is -1. The first cell of each part
    has sign 1. Where the signs of a part contradict each other, all its cells have sign 1. Parts are not numbered
    without gaps.
    """
    # Cell c is a node c with sign 1, and a node c + count with sign -1; nodes are linked where both signs are possible.
    same, opposite = other + count * (agree < 0), other + count * (agree > 0)
    links = np.concatenate([[one, same], [one + count, opposite], [np.arange(2 * count)] * 2], axis=1).T
    positive, negative = connected(links, 2 * count)[-2 * count :].reshape(2, count)
    return np.where(positive > negative, -1, 1), np.minimum(positive, negative)


def connected(cells: Ints, nodes: int) -> Ints:
    """Connected component (c,) of each cell, from 0; cells that share a node are in the same component.

    Each node points to a lower node of its component, at last to the lowest. SciPy has a function for this, but takes
    longer to import than this takes for a million cells.
    """
    lower = np.arange(nodes)
    while True:
        of_cell = lower[cells]
        lowest = of_cell.min(axis=1)
        if (of_cell == lowest[:, None]).all():
            return np.unique(lowest, return_inverse=True)[1].astype(np.int64)
        np.minimum.at(lower, of_cell.ravel(), np.repeat(lowest, cells.shape[1]))
        while not np.array_equal(lower, shorter := lower[lower]):
            lower = shorter
