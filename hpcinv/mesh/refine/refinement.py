"""Refinement of a mesh: all cells cut into eight, or marked cells bisected, with neighbours for conformity.

New nodes are mapped by the geometry of their cell, so that a curved body keeps its shape exactly.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from hpcinv.mesh.cells import FACET_KIND, scalar_element, sub_entities, vertex_count
from hpcinv.mesh.refine.bisection import bisected, edges_to_cut
from hpcinv.mesh.refine.degree import inner_dofs, of_degree, with_room
from hpcinv.mesh.refine.subdivision import Pieces, eighths, quarters
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.mesh.topology import find_rows, unique_rows, vertex_sets

CHUNK = 50_000


@dataclass(frozen=True)
class Refined:
    """A refined mesh, and the index (cells,) of the parent of each of its cells."""

    source: MeshSource
    parent: Ints


def refine(source: MeshSource, marked: Ints | None = None) -> Refined:
    """Cut every cell into eight, or bisect all edges of the ``marked`` tetrahedra and others for conformity.

    Remaining nodes and cells keep their tags; the pieces of a cell take its place in the order of cells. Groups are
    kept, nodal data are interpolated, and cell data are inherited. The source must be a valid mesh (`checks.check`).
    Not collective.

    Raises:
        ValueError: hexahedra are marked; they can only be refined everywhere.
    """
    if marked is not None and source.kind != "tetrahedron":
        raise ValueError("only tetrahedra can be refined in places")
    fine = of_degree(source, 2)  # has nodes at all places where a cell can be cut
    if marked is None:
        cells, facets = eighths(fine), quarters(FACET_KIND[fine.kind], fine.facets)
    else:
        cells, facets = _bisected(fine, marked)
    of = {2: facets.of, 3: cells.of}
    refined = dataclasses.replace(
        fine,
        degree=1,
        cells=cells.vertices,
        cell_tags=_cell_tags(source, cells.of),
        facets=facets.vertices,
        groups=tuple(
            dataclasses.replace(g, members=np.flatnonzero(np.isin(of[g.dim], g.members))) for g in fine.groups
        ),
        data={
            name: dataclasses.replace(a, values=a.values[cells.of]) if a.on == "cells" else a
            for name, a in fine.data.items()
        },
    )
    if source.degree == 2:
        refined = _curved(refined, fine, cells)
    return Refined(refined.without_unused_nodes(), cells.of)


def _bisected(fine: MeshSource, marked: Ints) -> tuple[Pieces, Pieces]:
    """Pieces of cells and facets of a mesh of degree 2 after bisection of the ``marked`` cells."""
    chosen = np.zeros(len(fine.cells), dtype=bool)
    chosen[marked] = True
    corners, middles = fine.cells[:, :4], fine.cells[:, inner_dofs(fine.kind, 1)]
    edges = edges_to_cut(fine.points, corners, middles, chosen)
    return bisected(corners, edges), bisected(fine.facets[:, :3], edges)


def _cell_tags(source: MeshSource, parent: Ints) -> Ints:
    """Old tags for cells that were not cut, new ones for pieces."""
    is_piece = np.bincount(parent, minlength=len(source.cells))[parent] > 1
    return np.where(is_piece, source.cell_tags.max() + np.cumsum(is_piece), source.cell_tags[parent])


def _curved(refined: MeshSource, fine: MeshSource, pieces: Pieces) -> MeshSource:
    """The ``refined`` mesh with degree 2, its nodes mapped by the geometry of the cells of ``fine``."""
    kind, facet_kind = refined.kind, FACET_KIND[refined.kind]
    cells, facets = with_room(kind, refined.cells), with_room(facet_kind, refined.facets)
    count = len(fine.points)
    parents, places = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
    for dim in (1, 2, 3):
        dofs, local = inner_dofs(kind, dim), sub_entities(kind, dim)
        if not len(dofs):
            continue
        sets, place = unique_rows(vertex_sets(refined.cells, local))
        middle = _middles(fine, dim, sets)
        new = middle < 0
        middle[new] = count + np.arange(np.count_nonzero(new))
        count += int(np.count_nonzero(new))
        cells[:, dofs] = middle[place].reshape(-1, len(dofs))
        if dim < 3 and len(facets):
            on_facet = inner_dofs(facet_kind, dim)
            found = find_rows(vertex_sets(refined.facets, sub_entities(facet_kind, dim)), sets)
            facets[:, on_facet] = middle[found].reshape(-1, len(on_facet))
        one = np.empty(len(sets), dtype=np.int64)
        one[place] = np.arange(len(place))  # any one of the cells that share it
        cell, entity = np.divmod(one[new], len(local))
        parents.append(pieces.of[cell])
        places.append(pieces.at[cell[:, None], local[entity]].mean(axis=1))
    parent, at = np.concatenate(parents), np.concatenate(places)

    def filled(values: Floats) -> Floats:
        return np.concatenate([values, mapped(fine, values, parent, at)])

    return dataclasses.replace(
        refined,
        degree=2,
        points=filled(fine.points),
        node_tags=np.concatenate([fine.node_tags, fine.node_tags.max() + 1 + np.arange(len(parent))]),
        cells=cells,
        facets=facets,
        data=refined.nodal_data(filled),
    )


def _middles(fine: MeshSource, dim: int, sets: Ints) -> Ints:
    """Node in the middle of each entity (given by sorted vertices) of ``fine``, -1 for other entities."""
    local = sub_entities(fine.kind, dim)
    old, place = unique_rows(vertex_sets(fine.cells[:, : vertex_count(fine.kind)], local))
    middle = np.full(len(old) + 1, -1, dtype=np.int64)
    middle[place] = fine.cells[:, inner_dofs(fine.kind, dim)].ravel()
    return middle[find_rows(sets, old)]


def mapped(source: MeshSource, values: Floats, cell: Ints, at: Floats) -> Floats:
    """Nodal ``values`` (n, c) at reference coordinates ``at`` (m, 3) of the cells ``cell`` (m,).

    If all nodes of an edge or a face have the same value, its points have exactly that value too, so that conditions
    such as ``x >= 1 m`` remain true on a plane end of the body.
    """
    element = scalar_element(source.kind, source.degree)
    result = np.empty((len(cell), values.shape[1]))
    for start in range(0, len(cell), CHUNK):
        part = slice(start, start + CHUNK)
        shapes: Floats = element.tabulate(0, at[part])[0, :, :, 0]
        shapes[np.abs(shapes) < 1e-14] = 0.0
        nodal = values[source.cells[cell[part]]]
        first = nodal[np.arange(len(shapes)), np.abs(shapes).argmax(axis=1)]
        result[part] = first + (shapes[:, None] @ (nodal - first[:, None]))[:, 0]
    return result
