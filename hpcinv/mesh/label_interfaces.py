"""Interfaces between labels of one conforming mesh: the nodes of their common surface are doubled.

At a node, two labels stay joined unless an interface is between them; labels that others join are joined, too. So each
set of joined labels has its own copy of the node. Where a third label meets the edge of an interface and is joined to
both sides, the edge is closed, as the front of a crack. On the outer boundary the interface is open.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from hpcinv.errors import MeshError
from hpcinv.mesh.cells import FACET_KIND, vertex_count
from hpcinv.mesh.facet_groups import add_facets
from hpcinv.mesh.regions import side_names
from hpcinv.mesh.source import Group, Ints, MeshSource
from hpcinv.mesh.topology import FacetTable

type Pairs = Sequence[tuple[str, str]]


def double_nodes(source: MeshSource, pairs: Pairs) -> MeshSource:
    """Return the mesh with doubled nodes between pairs of labels, whose sides are groups ``a|b`` and ``b|a``.

    Pairs that are not two labels are left out. Other groups have the facets of both sides.

    Raises:
        MeshError: two labels overlap, or do not touch each other.
    """
    surfaces = {group.name for group in source.groups if group.dim == 2}
    labels = list(dict.fromkeys(group.name for group in source.groups if group.dim == 3))
    pairs = [pair for pair in pairs if set(pair) <= set(labels) - surfaces]
    pairs = [pair for pair in pairs if not set(side_names(pair)) <= surfaces]  # else they have been doubled
    if not pairs:
        return source
    return _Doubling(source, pairs).source()


class _Doubling:
    """Copies of nodes between labels.

    Attributes:
        _colours: number (cells,) of the set of named labels that a cell belongs to.
        _copy: number of the copy (patterns, colours) at nodes with a pattern of colours.
        _pattern: of each node, (n,).
        _first_copy: number of the first further copy of each node, (n,).
    """

    def __init__(self, source: MeshSource, pairs: Pairs) -> None:
        self._source, self._pairs = source, pairs
        names = list(dict.fromkeys(itertools.chain(*pairs)))
        members = np.zeros((len(source.cells), len(names)), dtype=bool)
        for group in source.groups:
            if group.dim == 3 and group.name in names:
                members[group.members, names.index(group.name)] = True
        self._sets, self._colours = np.unique(members, axis=0, return_inverse=True)
        self._colours = self._colours.ravel()
        self._places = [(names.index(a), names.index(b)) for a, b in pairs]
        for (a, b), (i, j) in zip(pairs, self._places, strict=True):
            if count := int((members[:, i] & members[:, j]).sum()):
                raise MeshError(
                    f"{source.path}: {count} cells are in both '{a}' and '{b}', between which an interface is",
                    "Name two labels that share no cell.",
                )
        present = np.zeros((len(source.points), len(self._sets)), dtype=bool)
        present[source.cells, self._colours[:, None]] = True
        patterns, self._pattern = np.unique(present, axis=0, return_inverse=True)
        self._pattern = self._pattern.ravel()
        self._copy = np.array([self._copies(pattern) for pattern in patterns])
        further = self._copy.max(axis=1)[self._pattern]
        self._first_copy = len(source.points) + np.cumsum(further) - further
        self._originals = np.repeat(np.arange(len(source.points)), further)

    def _copies(self, pattern: Ints) -> Ints:
        """Return the copy that each colour has at nodes with a pattern of present colours, 0 for absent ones."""
        copies, count = np.zeros(len(pattern), dtype=np.int64), 0
        left = np.flatnonzero(pattern).tolist()
        while left:
            joined = [left.pop(0)]
            for one in joined:
                near = [other for other in left if not self._is_cut(one, other)]
                joined += near
                left = [other for other in left if other not in near]
            copies[joined], count = count, count + 1
        return copies

    def _is_cut(self, one: int, other: int) -> bool:
        a, b = self._sets[one], self._sets[other]
        return any((a[i] and b[j]) or (a[j] and b[i]) for i, j in self._places)

    def _renumbered(self, nodes: Ints, colours: Ints) -> Ints:
        """Return the nodes (n, k) that cells of these colours (n,) have."""
        copy = self._copy[self._pattern[nodes], colours[:, None]]
        return np.where(copy > 0, self._first_copy[nodes] + copy - 1, nodes)

    def source(self) -> MeshSource:
        source, originals = self._source, self._originals
        table = FacetTable.build(source.kind, source.cells[:, : vertex_count(source.kind)])
        cells = self._renumbered(source.cells, self._colours)
        facets, groups = self._facets(table)
        names = set(itertools.chain(*map(side_names, self._pairs)))
        first_tag = int(source.node_tags.max(initial=0)) + 1
        doubled = dataclasses.replace(
            source,
            points=np.concatenate([source.points, source.points[originals]]),
            node_tags=np.concatenate([source.node_tags, first_tag + np.arange(len(originals))]),
            cells=cells,
            facets=facets,
            groups=tuple(group for group in groups if group.name not in names),
            data=source.nodal_data(lambda values: np.concatenate([values, values[originals]])),
        )
        return add_facets(doubled, self._open_sides(table, cells))

    def _facets(self, table: FacetTable) -> tuple[Ints, list[Group]]:
        """Return the facets of groups, once for each side where these differ, and the groups."""
        source = self._source
        corners = source.facets[:, : vertex_count(FACET_KIND[source.kind])]
        rows = table.find(corners)
        owners = self._owners(table)[rows]
        first, second = (self._renumbered(source.facets, self._colours[owners[:, k]]) for k in (0, 1))
        known = rows >= 0
        first = np.where(known[:, None], first, source.facets)
        differs = known & (first != second).any(axis=1)
        place = np.full(len(source.facets), -1)
        place[differs] = len(source.facets) + np.arange(int(differs.sum()))
        groups = []
        for group in source.groups:
            if group.dim == 2:
                copies = place[group.members]
                group = dataclasses.replace(group, members=np.concatenate([group.members, copies[copies >= 0]]))
            groups.append(group)
        return np.concatenate([first, second[differs]]), groups

    @staticmethod
    def _owners(table: FacetTable) -> Ints:
        """Return the two cells of each facet, (f, 2); twice the same one on the boundary."""
        facets = table.cell_facets.ravel()
        cells = np.repeat(np.arange(len(table.cell_facets)), table.cell_facets.shape[1])
        owners = np.empty((len(table.vertices), 2), dtype=np.int64)
        owners[facets[::-1], 0] = cells[::-1]
        owners[facets, 1] = cells
        return owners

    def _open_sides(self, table: FacetTable, cells: Ints) -> dict[str, Ints]:
        """Return cell and local number of the facets on each side of the pairs that are open now."""
        kind = self._source.kind
        after = FacetTable.build(kind, cells[:, : vertex_count(kind)])
        opened = (table.sharing[table.cell_facets] == 2) & (after.sharing[after.cell_facets] == 1)
        rows = np.argwhere(opened)
        owners = self._owners(table)[table.cell_facets[opened]]
        other = np.where(owners[:, 0] == rows[:, 0], owners[:, 1], owners[:, 0])
        here, there = self._sets[self._colours[rows[:, 0]]], self._sets[self._colours[other]]
        sides = dict[str, Ints]()
        for (a, b), (i, j) in zip(self._pairs, self._places, strict=True):
            if not (is_first := here[:, i] & there[:, j]).any():
                raise MeshError(
                    f"{self._source.path}: the interface between '{a}' and '{b}' is on no facet: they share none,"
                    " or other labels join them everywhere",
                    "Name two labels that touch each other, or two regions of the boundary.",
                )
            for name, chosen in zip(side_names((a, b)), (is_first, here[:, j] & there[:, i]), strict=True):
                sides[name] = rows[chosen]
        return sides
