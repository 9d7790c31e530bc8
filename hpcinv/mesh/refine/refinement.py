"""Refinement of a mesh: all cells cut into eight, or marked cells bisected, with neighbours for conformity.

New nodes are mapped by the geometry of their cell, so that a curved body keeps its shape exactly.

Source of the longest-edge bisection: Plaza & Carey, *Local refinement of simplicial grids based on the skeleton*, Appl.
Numer. Math. 32 (2000), doi:10.1016/S0168-9274(99)00022-7.
"""

import dataclasses
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from hpcinv.mesh.cells import FACET_KIND, scalar_element, sub_entities
from hpcinv.mesh.refine.degree import add_inner_nodes, change_degree, inner_dofs
from hpcinv.mesh.refine.subdivision import Pieces, eighths, quarters
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.mesh.topology import find_rows, unique_rows, vertex_sets

SIMPLICES = {3: "triangle", 4: "tetrahedron"}  # by the number of vertices


@dataclass(frozen=True)
class RefinedMesh:
    """A refined mesh, and the index (cells,) of the parent of each of its cells."""

    source: MeshSource
    parent: Ints


def refine(source: MeshSource, marked: Ints | None = None) -> RefinedMesh:
    """Cut every cell into eight, or bisect all edges of the ``marked`` tetrahedra and others for conformity.

    Remaining nodes and cells keep their tags; the pieces of a cell take its place in the order of cells. Groups are
    kept, nodal data are interpolated, and cell data are inherited. The source must be a valid mesh (`checks.check`).
    Not collective.

    Raises:
        ValueError: hexahedra are marked; they can only be refined everywhere.
    """
    if marked is not None and source.kind != "tetrahedron":
        raise ValueError("only tetrahedra can be refined in places")
    fine = change_degree(source, 2)  # has nodes at all places where a cell can be cut
    if marked is None:
        cells, facets = eighths(fine), quarters(FACET_KIND[fine.kind], fine.facets)
    else:
        cells, facets = _bisected(fine, marked)
    parents = {2: facets.parents, 3: cells.parents}
    refined = dataclasses.replace(
        fine,
        degree=1,
        cells=cells.vertices,
        cell_tags=_cell_tags(source, cells.parents),
        facets=facets.vertices,
        groups=tuple(
            dataclasses.replace(g, members=np.flatnonzero(np.isin(parents[g.dim], g.members))) for g in fine.groups
        ),
        data={
            name: dataclasses.replace(a, values=a.values[cells.parents]) if a.place == "cells" else a
            for name, a in fine.data.items()
        },
    )
    if source.degree == 2:
        refined = add_inner_nodes(refined, fine, cells.parents, cells.positions)
    return RefinedMesh(refined.drop_unused_nodes(), cells.parents)


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
