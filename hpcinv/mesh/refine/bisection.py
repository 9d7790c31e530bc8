"""Conforming longest-edge bisection of tetrahedra and triangles.

Source: Plaza & Carey, *Local refinement of simplicial grids based on the skeleton*, Appl. Numer. Math. 32 (2000),
doi:10.1016/S0168-9274(99)00022-7.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from hpcinv.mesh.cells import scalar_element, sub_entities
from hpcinv.mesh.refine.subdivision import Pieces
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.topology import find_rows, unique_rows, vertex_sets

SIMPLICES = {3: "triangle", 4: "tetrahedron"}  # by the number of vertices


@cache
def _edges_of_faces() -> list[list[int]]:
    edges, faces = (sub_entities("tetrahedron", dim).tolist() for dim in (1, 2))
    return [[i for i, edge in enumerate(edges) if set(edge) <= set(face)] for face in faces]


@dataclass(frozen=True)
class CutEdges:
    """Edges that are bisected: sorted ``vertices`` (e, 2), ``middle`` node (e,) and ``rank`` (e,) by length.

    Longer edges have higher ranks, and no two edges have the same rank. Every cell cuts its longer edges first, so that
    the pieces of neighbours conform.
    """

    vertices: Ints
    middle: Ints
    rank: Ints


def edges_to_cut(points: Floats, cells: Ints, middles: Ints, marked: npt.NDArray[np.bool_]) -> CutEdges:
    """All edges of the ``marked`` (c,) tetrahedra, and further edges that must be cut for conformity.

    If an edge is cut, so is the longest edge of every face and every tetrahedron that contains it.

    Args:
        cells: vertices (c, 4).
        middles: nodes (c, 6) in the middle of the edges of ``cells``.
    """
    vertices, cell_edges = unique_rows(vertex_sets(cells, sub_entities("tetrahedron", 1)))
    cell_edges = cell_edges.reshape(-1, 6)
    middle = np.empty(len(vertices), dtype=np.int64)
    middle[cell_edges] = middles
    lengths = np.linalg.norm(points[vertices[:, 1]] - points[vertices[:, 0]], axis=1)
    rank = np.empty(len(vertices), dtype=np.int64)
    rank[np.argsort(lengths, kind="stable")] = np.arange(len(vertices))
    # Each row is the edges of a cell or of a face.
    sets = [cell_edges, *(cell_edges[:, edges] for edges in _edges_of_faces())]
    longest = [np.take_along_axis(s, rank[s].argmax(axis=1)[:, None], axis=1)[:, 0] for s in sets]
    cut = np.zeros(len(vertices), dtype=bool)
    cut[cell_edges[marked]] = True
    count = -1
    while count != (count := int(np.count_nonzero(cut))):
        for edges, last in zip(sets, longest, strict=True):
            cut[last[cut[edges].any(axis=1)]] = True
    return CutEdges(vertices[cut], middle[cut], rank[cut])


def bisected(simplices: Ints, edges: CutEdges) -> Pieces:
    """Pieces of simplices (s, k) cut at ``edges``, the longest first; ordered by simplex."""
    kind = SIMPLICES[simplices.shape[1]]
    corners: Floats = scalar_element(kind, 1).points
    pieces = Pieces(simplices, np.arange(len(simplices)), np.broadcast_to(corners, (len(simplices), *corners.shape)))
    local, ranks = sub_entities(kind, 1), np.append(edges.rank, -1)
    done = [_select(pieces, np.zeros(0, dtype=np.int64))]
    while len(pieces.parents):
        edge_rows = find_rows(vertex_sets(pieces.vertices, local), edges.vertices).reshape(-1, len(local))
        longest = ranks[edge_rows].argmax(axis=1)
        cut = np.take_along_axis(edge_rows, longest[:, None], axis=1)[:, 0]
        done.append(_select(pieces, cut < 0))
        pieces = _halves(_select(pieces, cut >= 0), local[longest[cut >= 0]], edges.middle[cut[cut >= 0]])
    joined = Pieces(
        np.concatenate([p.vertices for p in done]),
        np.concatenate([p.parents for p in done]),
        np.concatenate([p.positions for p in done]),
    )
    return _select(joined, np.argsort(joined.parents, kind="stable"))


def _halves(pieces: Pieces, ends: Ints, middle: Ints) -> Pieces:
    """Two halves of each piece: one or the other end (local vertices (s, 2)) of an edge is replaced by its middle."""
    rows = np.arange(len(pieces.parents))
    vertices, positions = [], []
    half = (pieces.positions[rows, ends[:, 0]] + pieces.positions[rows, ends[:, 1]]) / 2
    for end in ends.T:
        vertices.append(pieces.vertices.copy())
        vertices[-1][rows, end] = middle
        positions.append(pieces.positions.copy())
        positions[-1][rows, end] = half
    return Pieces(np.concatenate(vertices), np.concatenate([pieces.parents] * 2), np.concatenate(positions))


def _select(pieces: Pieces, chosen: npt.NDArray[np.bool_] | Ints) -> Pieces:
    return Pieces(pieces.vertices[chosen], pieces.parents[chosen], pieces.positions[chosen])
