"""Conversion of the geometry of a mesh between degree 1 and degree 2 with straight edges."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from hpcinv.mesh.cells import FACET_KIND, scalar_element, sub_entities, vertex_count
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.mesh.topology import find_rows, unique_rows, vertex_sets

CHUNK = 50_000


def change_degree(source: MeshSource, degree: int) -> MeshSource:
    """The same mesh with a geometry of another degree; remaining nodes keep their tags, new ones follow."""
    if degree == source.degree:
        return source
    return raised(source) if degree == 2 else lowered(source)


def lowered(source: MeshSource) -> MeshSource:
    """The mesh with its vertices only, of degree 1."""
    vertices, facet_vertices = vertex_count(source.kind), vertex_count(FACET_KIND[source.kind])
    flat = dataclasses.replace(
        source, degree=1, cells=source.cells[:, :vertices], facets=source.facets[:, :facet_vertices]
    )
    return flat.drop_unused_nodes()


def raised(source: MeshSource) -> MeshSource:
    """The mesh with additional nodes in the middle of every edge, quadrilateral and hexahedron, of degree 2.

    Nodal data arrays have the mean of the vertices there.
    """
    vertices: Floats = scalar_element(source.kind, 1).points
    cells = np.arange(len(source.cells))
    return add_inner_nodes(source, source, cells, np.broadcast_to(vertices, (len(cells), *vertices.shape)))


def add_inner_nodes(mesh: MeshSource, parents: MeshSource, parent: Ints, corners: Floats) -> MeshSource:
    """``mesh``, which has vertices only, with degree 2; its new nodes are mapped by the geometry of ``parents``.

    Args:
        mesh: pieces of the cells of ``parents``, with the nodes of ``parents``.
        parents: its nodes in the middle of entities of ``mesh``, if it has any, are used again.
        parent: parent (m,) of each cell.
        corners: reference coordinates (m, k, 3) of the vertices of each cell in its parent.
    """
    kind, facet_kind = mesh.kind, FACET_KIND[mesh.kind]
    cells, facets = pad_entities(kind, mesh.cells), pad_entities(facet_kind, mesh.facets)
    count = len(parents.points)
    found_in, places = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
    for dim in (1, 2, 3):
        dofs, local = inner_dofs(kind, dim), sub_entities(kind, dim)
        if not len(dofs):
            continue
        sets, place = unique_rows(vertex_sets(mesh.cells, local))
        middle = _middles(parents, dim, sets)
        new = middle < 0
        middle[new] = count + np.arange(np.count_nonzero(new))
        count += int(np.count_nonzero(new))
        cells[:, dofs] = middle[place].reshape(-1, len(dofs))
        if dim < 3 and len(facets):
            facet_dofs = inner_dofs(facet_kind, dim)
            set_rows = find_rows(vertex_sets(mesh.facets, sub_entities(facet_kind, dim)), sets)
            # -1 for an edge of no cell: the check of facets reports it.
            facets[:, facet_dofs] = np.where(set_rows < 0, -1, middle[set_rows]).reshape(-1, len(facet_dofs))
        owner = np.empty(len(sets), dtype=np.int64)
        owner[place] = np.arange(len(place))  # any one of the cells that share it
        cell, entity = np.divmod(owner[new], len(local))
        found_in.append(parent[cell])
        places.append(corners[cell[:, None], local[entity]].mean(axis=1))
    new_cells, new_points = np.concatenate(found_in), np.concatenate(places)

    def filled(values: Floats) -> Floats:
        return np.concatenate([values, mapped(parents, values, new_cells, new_points)])

    return dataclasses.replace(
        mesh,
        degree=2,
        points=filled(parents.points),
        node_tags=np.concatenate([parents.node_tags, parents.node_tags.max() + 1 + np.arange(len(new_cells))]),
        cells=cells,
        facets=facets,
        data=mesh.nodal_data(filled),
    )


def _middles(fine: MeshSource, dim: int, sets: Ints) -> Ints:
    """Node in the middle of each entity (given by sorted vertices) of ``fine``, -1 for other entities."""
    if fine.degree == 1:
        return np.full(len(sets), -1, dtype=np.int64)
    local = sub_entities(fine.kind, dim)
    old, place = unique_rows(vertex_sets(fine.cells[:, : vertex_count(fine.kind)], local))
    middle = np.full(len(old) + 1, -1, dtype=np.int64)
    middle[place] = fine.cells[:, inner_dofs(fine.kind, dim)].ravel()
    return middle[find_rows(sets, old)]


def mapped(source: MeshSource, values: Floats, cell: Ints, reference_points: Floats) -> Floats:
    """Nodal ``values`` (n, c) at reference coordinates ``reference_points`` (m, 3) of the cells ``cell`` (m,).

    If all nodes of an edge or a face have the same value, its points have exactly that value too, so that conditions
    such as ``x >= 1 m`` remain true on a plane end of the body.
    """
    element = scalar_element(source.kind, source.degree)
    result = np.empty((len(cell), values.shape[1]))
    for start in range(0, len(cell), CHUNK):
        part = slice(start, start + CHUNK)
        shapes: Floats = element.tabulate(0, reference_points[part])[0, :, :, 0]
        shapes[np.abs(shapes) < 1e-14] = 0.0
        nodal = values[source.cells[cell[part]]]
        first = nodal[np.arange(len(shapes)), np.abs(shapes).argmax(axis=1)]
        result[part] = first + (shapes[:, None] @ (nodal - first[:, None]))[:, 0]
    return result


def centre_weights(kind: str) -> Iterator[tuple[int, Floats]]:
    """Yield the nodes of degree 2 in faces and cells, and the shape functions (k,) there of 8 or 20 nodes on edges."""
    element = scalar_element(kind, 2)
    for dim in range(2, len(element.entity_dofs)):
        for dofs, closure in zip(element.entity_dofs[dim], element.entity_closure_dofs[dim], strict=True):
            weights = np.zeros(element.dim)
            for inner, weight in ((0, -1 / 4), (1, 1 / 2 if dim == 2 else 1 / 4)):
                weights[[node for node in closure if node in set(inner_dofs(kind, inner))]] = weight
            for dof in dofs:
                yield dof, weights


def serendipity(kind: str, cells: Ints, points: Floats) -> Floats:
    """Return points (n, 3) of cells of degree 2 whose nodes in faces and cells follow from those on their edges."""
    result = np.array(points)
    for dof, weights in centre_weights(kind):
        result[cells[:, dof]] = np.einsum("k,ckd->cd", weights, points[cells])
    return result


def inner_dofs(kind: str, dim: int) -> Ints:
    """Local nodes of degree 2 in the interior of the sub-entities of dimension ``dim``: one for each, or none."""
    return np.array(scalar_element(kind, 2).entity_dofs[dim], dtype=np.int64).ravel()


def pad_entities(kind: str, entities: Ints) -> Ints:
    """Node array of degree 2 with the vertices of ``entities``, -1 for the other nodes."""
    wide = np.full((len(entities), scalar_element(kind, 2).dim), -1, dtype=np.int64)
    wide[:, : entities.shape[1]] = entities
    return wide
