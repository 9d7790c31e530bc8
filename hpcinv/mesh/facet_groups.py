"""Groups of facets of a mesh: each facet once, whatever the number of its groups, and further groups."""

import dataclasses
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from hpcinv.mesh.cells import FACET_KIND, scalar_element, vertex_count
from hpcinv.mesh.source import Group, Ints, MeshSource, distinct_tags
from hpcinv.mesh.topology import FacetTable, unique_rows


def join_facets(source: MeshSource) -> MeshSource:
    """Return the mesh with each facet once, in all groups that have it; files may list it for each of them."""
    corners = np.sort(source.facets[:, : vertex_count(FACET_KIND[source.kind])], axis=1)
    distinct, place = unique_rows(corners)
    if len(distinct) == len(corners):
        return source
    first = np.full(len(distinct), len(corners))
    np.minimum.at(first, place, np.arange(len(corners)))
    kept = np.sort(first)
    row = np.searchsorted(kept, first)[place]
    groups = (dataclasses.replace(g, members=np.unique(row[g.members])) if g.dim == 2 else g for g in source.groups)
    return dataclasses.replace(source, facets=source.facets[kept], groups=tuple(groups))


def add_facets(source: MeshSource, sides: Mapping[str, Ints]) -> MeshSource:
    """Return the mesh with further groups of facets.

    Args:
        sides: facets of each group, by its name: rows (n, 2) of a cell and the local number of its facet in DOLFINx.
    """
    groups, facets, count = list(source.groups), [source.facets], len(source.facets)
    for name, rows in sides.items():
        facets.append(facets_of_cells(source, rows))
        groups.append(Group(name, 2, 0, np.arange(count, count + len(rows))))
        count += len(rows)
    return join_facets(dataclasses.replace(source, facets=np.concatenate(facets), groups=distinct_tags(groups)))


def facets_of_cells(source: MeshSource, sides: Ints) -> Ints:
    """Return the nodes (n, l) of facets: rows (n, 2) of a cell and the local number of a facet, as DOLFINx counts."""
    nodes = np.array(scalar_element(source.kind, source.degree).entity_closure_dofs[2], dtype=np.int64)
    return source.cells[sides[:, 0, None], nodes[sides[:, 1]]]


def facets_and_cells_inside(table: FacetTable, vertices: Ints, is_inside: npt.NDArray[np.bool_]) -> tuple[Ints, Ints]:
    """Return rows of the boundary facets and of the cells all of whose vertices are marked.

    Args:
        table: of the mesh's facets.
        vertices: (c, v) of the cells.
        is_inside: (n,) whether a node is marked.
    """
    facets = np.flatnonzero((table.sharing == 1) & is_inside[table.vertices].all(axis=1))
    return facets, np.flatnonzero(is_inside[vertices].all(axis=1))
