"""Subdivision of cells into eight and of facets into four, at the nodes of degree 2."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from hpcinv.mesh.cells import scalar_element, vertex_count
from hpcinv.mesh.source import Floats, Ints, MeshSource


@dataclass(frozen=True)
class Pieces:
    """Pieces of cells or facets.

    Attributes:
        vertices: of each piece (s, k).
        of: parent (s,) of each piece.
        at: reference coordinates (s, k, d) of the vertices in the parent.
    """

    vertices: Ints
    parents: Ints
    positions: Floats


def eighths(source: MeshSource) -> Pieces:
    """Pieces of every cell of a mesh of degree 2; octahedra in tetrahedra are cut along their shortest diagonal."""
    if source.kind == "hexahedron":
        return _cut(source.kind, source.cells, _octants())
    ways = _tetrahedra()
    ends = source.points[source.cells[:, ways[:, -1, :2]]]
    shortest = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).argmin(axis=1)
    return _cut(source.kind, source.cells, ways[shortest])


def quarters(kind: str, facets: Ints) -> Pieces:
    """Pieces of triangles or quadrilaterals of degree 2."""
    corners = _nodes(kind)[: vertex_count(kind)]
    pieces = list((corners[:, None] + corners) / 2)
    if kind == "triangle":
        pieces.append((corners[[1, 2, 0]] + corners[[2, 0, 1]]) / 2)
    return _cut(kind, facets, _nearest(kind, np.array(pieces)))


def _cut(kind: str, entities: Ints, template: Ints) -> Pieces:
    """Pieces with the local nodes ``template``: (pieces, k) for all entities, or (entities, pieces, k)."""
    count, k = template.shape[-2:]
    templates = np.broadcast_to(template, (len(entities), count, k))
    rows = np.arange(len(entities))
    return Pieces(
        entities[rows[:, None, None], templates].reshape(-1, k),
        np.repeat(rows, count),
        _nodes(kind)[templates].reshape(count * len(entities), k, _nodes(kind).shape[1]),
    )


@cache
def _octants() -> Ints:
    """Local nodes (8, 8) of the pieces of a hexahedron."""
    corners = _nodes("hexahedron")[:8]
    return _nearest("hexahedron", (corners[:, None] + corners) / 2)


@cache
def _tetrahedra() -> Ints:
    """Local nodes (3, 8, 4) of the pieces of a tetrahedron for each diagonal: four at its corners, four around it."""
    corners = _nodes("tetrahedron")[:4]
    middle = (corners[:, None] + corners) / 2
    ways = []
    for i in (1, 2, 3):
        j, k = (n for n in (1, 2, 3) if n != i)
        # The midpoints of the edges 0–i and j–k are opposite; the other four are on a ring around this diagonal.
        ring = [middle[0, j], middle[i, j], middle[i, k], middle[0, k]]
        inner = [[middle[0, i], middle[j, k], ring[n], ring[(n + 1) % 4]] for n in range(4)]
        ways.append([*middle, *inner])
    corner_points = np.array(ways)
    right_handed = np.linalg.det(corner_points[:, :, 1:] - corner_points[:, :, :1]) > 0
    nodes = _nearest("tetrahedron", corner_points)
    return np.where(right_handed[..., None], nodes, nodes[..., [0, 1, 3, 2]])


def _nodes(kind: str) -> Floats:
    nodes: Floats = scalar_element(kind, 2).points
    return nodes


def _nearest(kind: str, reference_points: Floats) -> Ints:
    """Nodes of degree 2 at reference coordinates (…, d)."""
    return np.asarray(
        np.abs(reference_points[..., None, :] - _nodes(kind)).max(axis=-1).argmin(axis=-1), dtype=np.int64
    )
