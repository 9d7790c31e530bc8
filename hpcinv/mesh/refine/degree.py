"""Conversion of the geometry of a mesh between degree 1 and degree 2 with straight edges."""

from __future__ import annotations

import dataclasses

import numpy as np

from hpcinv.mesh.cells import FACET_KIND, scalar_element, sub_entities, vertex_count
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.mesh.topology import find_rows, unique_rows, vertex_sets


def of_degree(source: MeshSource, degree: int) -> MeshSource:
    """The same mesh with a geometry of another degree; remaining nodes keep their tags, new ones follow."""
    if degree == source.degree:
        return source
    return raised(source) if degree == 2 else lowered(source)


def lowered(source: MeshSource) -> MeshSource:
    """The mesh with its vertices only, of degree 1."""
    vertices, of_facet = vertex_count(source.kind), vertex_count(FACET_KIND[source.kind])
    flat = dataclasses.replace(source, degree=1, cells=source.cells[:, :vertices], facets=source.facets[:, :of_facet])
    return flat.without_unused_nodes()


def raised(source: MeshSource) -> MeshSource:
    """The mesh with additional nodes in the middle of every edge, quadrilateral and hexahedron, of degree 2.

    Nodal data arrays have the mean of the vertices there.
    """
    between: list[Ints] = []
    cells = with_room(source.kind, source.cells)
    facet_kind = FACET_KIND[source.kind]
    facets = with_room(facet_kind, source.facets)
    count = len(source.points)
    for dim in (1, 2, 3):
        dofs = inner_dofs(source.kind, dim)
        if not len(dofs):
            continue
        sets, place = unique_rows(vertex_sets(source.cells, sub_entities(source.kind, dim)))
        cells[:, dofs] = count + place.reshape(-1, len(dofs))
        if dim < 3 and len(source.facets):
            on_facet = inner_dofs(facet_kind, dim)
            found = find_rows(vertex_sets(source.facets, sub_entities(facet_kind, dim)), sets)
            # -1 for an edge of no cell: the check of facets reports it.
            facets[:, on_facet] = np.where(found < 0, -1, count + found).reshape(-1, len(on_facet))
        between.append(sets)
        count += len(sets)

    def filled(values: Floats) -> Floats:
        return np.concatenate([values, *(values[sets].mean(axis=1) for sets in between)])

    new = count - len(source.points)
    tags = np.concatenate([source.node_tags, source.node_tags.max() + 1 + np.arange(new)])
    return dataclasses.replace(
        source,
        degree=2,
        points=filled(source.points),
        node_tags=tags,
        cells=cells,
        facets=facets,
        data=source.nodal_data(filled),
    )


def inner_dofs(kind: str, dim: int) -> Ints:
    """Local nodes of degree 2 in the interior of the sub-entities of dimension ``dim``: one for each, or none."""
    return np.array(scalar_element(kind, 2).entity_dofs[dim], dtype=np.int64).ravel()


def with_room(kind: str, entities: Ints) -> Ints:
    """Node array of degree 2 with the vertices of ``entities``, -1 for the other nodes."""
    wide = np.full((len(entities), scalar_element(kind, 2).dim), -1, dtype=np.int64)
    wide[:, : entities.shape[1]] = entities
    return wide
