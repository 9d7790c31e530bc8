"""Facets of a cell array, and rows of integers matched as sets of vertices; numpy alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpcinv.mesh.cells import sub_entities
from hpcinv.mesh.source import Ints


def unique_rows(rows: Ints) -> tuple[Ints, Ints]:
    """The distinct rows, sorted, and for each given row its place among them."""
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    starts = np.ones(len(rows), dtype=bool)
    starts[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    place = np.empty(len(rows), dtype=np.int64)
    place[order] = np.cumsum(starts) - 1
    return ordered[starts], place


def find_rows(rows: Ints, table: Ints) -> Ints:
    """For each row its place in ``table`` (distinct rows), or -1 where it is not there."""
    _, place = unique_rows(np.concatenate([table, rows]))
    where = np.full(len(place), -1, dtype=np.int64)
    where[place[: len(table)]] = np.arange(len(table))
    return where[place[len(table) :]]


def vertex_sets(entities: Ints, local: Ints) -> Ints:
    """Sorted vertices of every sub-entity ``local`` (s, v) of every entity, entity by entity: (entities·s, v)."""
    return np.sort(entities[:, local].reshape(-1, local.shape[1]), axis=1)


@dataclass(frozen=True)
class FacetTable:
    """Every facet of a mesh once: sorted ``vertices`` (f, v), and the number of cells that have it."""

    vertices: Ints
    sharing: Ints
    of_cell: Ints  # (cells, facets of a cell): rows of ``vertices``

    @classmethod
    def of(cls, kind: str, cells: Ints) -> FacetTable:
        """Build the table of a mesh of ``cells``."""
        local = sub_entities(kind, 2)
        vertices, place = unique_rows(vertex_sets(cells, local))
        return cls(vertices, np.bincount(place, minlength=len(vertices)), place.reshape(-1, len(local)))

    def find(self, facets: Ints) -> Ints:
        """Rows of the table for ``facets`` given by their vertices in any order; -1 for what is no facet."""
        return find_rows(np.sort(facets, axis=1), self.vertices)

    def edge_cut(self, part: Ints) -> int:
        """Number of facets between two cells of different ``part``: the cut edges of the dual graph."""
        of_cell = np.broadcast_to(part[:, None], self.of_cell.shape)
        least = np.full(len(self.vertices), np.iinfo(np.int64).max)
        most = np.full(len(self.vertices), -1)
        np.minimum.at(least, self.of_cell, of_cell)
        np.maximum.at(most, self.of_cell, of_cell)
        return int((least != most).sum())


def connected(cells: Ints, nodes: int) -> Ints:
    """Number of the part of a mesh that each cell belongs to, from 0; cells that share a node are of one part.

    Every node takes the least number around it, and jumps to that of the node it has it from (Shiloach and Vishkin,
    1982, doi:10.1016/0196-6774(82)90008-6), which ends after about as many rounds as the number of nodes has digits.
    """
    root = np.arange(nodes, dtype=np.int64)
    while True:
        of_cell = root[cells]
        least = of_cell.min(axis=1)
        if (of_cell == least[:, None]).all():
            return np.unique(least, return_inverse=True)[1].astype(np.int64)
        np.minimum.at(root, of_cell, least[:, None])
        while not np.array_equal(root, root[root]):
            root = root[root]
