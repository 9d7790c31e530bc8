"""Cells cut into eight, and their facets into four, at the nodes of degree 2."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from hpcinv.mesh.cells import scalar_element, vertex_count
from hpcinv.mesh.source import Floats, Ints, MeshSource


@dataclass(frozen=True)
class Pieces:
    """Pieces of cells or facets: their ``vertices`` (s, k), and the cell or facet that each is a piece ``of``.

    ``at`` (s, k, d) are the reference coordinates that the vertices have in it.
    """

    vertices: Ints
    of: Ints
    at: Floats


def eighths(source: MeshSource) -> Pieces:
    """Every cell of a mesh of degree 2 cut into eight, octahedra inside tetrahedra along their shortest diagonal."""
    if source.kind == "hexahedron":
        return _cut(source.kind, source.cells, _octants())
    ways = _tetrahedra()
    ends = source.points[source.cells[:, ways[:, -1, :2]]]
    shortest = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).argmin(axis=1)
    return _cut(source.kind, source.cells, ways[shortest])


def quarters(kind: str, facets: Ints) -> Pieces:
    """Triangles or quadrilaterals of degree 2 cut into four."""
    corners = _nodes(kind)[: vertex_count(kind)]
    pieces = list((corners[:, None] + corners) / 2)
    if kind == "triangle":
        pieces.append((corners[[1, 2, 0]] + corners[[2, 0, 1]]) / 2)
    return _cut(kind, facets, _nearest(kind, np.array(pieces)))


def _cut(kind: str, entities: Ints, template: Ints) -> Pieces:
    """Pieces whose vertices are the nodes ``template``, (pieces, k) for all entities, or one such for each of them."""
    count, k = template.shape[-2:]
    templates = np.broadcast_to(template, (len(entities), count, k))
    rows = np.arange(len(entities))
    return Pieces(
        entities[rows[:, None, None], templates].reshape(-1, k),
        np.repeat(rows, count),
        _nodes(kind)[templates].reshape(count * len(entities), k, -1),
    )


@cache
def _octants() -> Ints:
    """A hexahedron cut into eight, (8, 8)."""
    corners = _nodes("hexahedron")[:8]
    return _nearest("hexahedron", (corners[:, None] + corners) / 2)


@cache
def _tetrahedra() -> Ints:
    """A tetrahedron cut into eight in three ways, (3, 8, 4): four at its corners, four around a diagonal."""
    corners = _nodes("tetrahedron")[:4]
    middle = (corners[:, None] + corners) / 2
    ways = []
    for i in (1, 2, 3):
        j, k = (n for n in (1, 2, 3) if n != i)
        # The middles of the edges 0–i and j–k are opposite; the other four go around between them.
        ring = [middle[0, j], middle[i, j], middle[i, k], middle[0, k]]
        inside = [[middle[0, i], middle[j, k], ring[n], ring[(n + 1) % 4]] for n in range(4)]
        ways.append([*middle, *inside])
    at = np.array(ways)
    right_handed = np.linalg.det(at[:, :, 1:] - at[:, :, :1]) > 0
    nodes = _nearest("tetrahedron", at)
    return np.where(right_handed[..., None], nodes, nodes[..., [0, 1, 3, 2]])


def _nodes(kind: str) -> Floats:
    """Reference nodes of degree 2."""
    nodes: Floats = scalar_element(kind, 2).points
    return nodes


def _nearest(kind: str, at: Floats) -> Ints:
    """The nodes of degree 2 that lie at reference coordinates (…, d)."""
    return np.asarray(np.abs(at[..., None, :] - _nodes(kind)).max(axis=-1).argmin(axis=-1), dtype=np.int64)
