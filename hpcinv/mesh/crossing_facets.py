"""Facets of a boundary that cross each other: the body passes through itself there."""

from dataclasses import dataclass

import dolfinx
import numpy as np
import numpy.typing as npt
from dolfinx import geometry

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.cells import coordinate_element
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.surface import Surface, Triangles
from hpcinv.mesh.topology import find_rows, unique_rows

_TOUCH = 1e-9  # depth up to which parts touch, relative to the body's diagonal
_OF_EDGE = 1e-3  # largest such depth, relative to the shortest edge: thin walls and fine parts stay as they are
_FLAT = 1e-6  # regularisation of least squares where the surface is flat
_CHUNK = 200_000  # pairs of triangles at a time, to bound the memory
_FINER = 4  # further subdivisions of curved facets; a crossing must persist on them

_EDGES = ((0, 1), (1, 2), (2, 0))


@dataclass(frozen=True)
class Overlap:
    """Number of pairs of boundary facets that cross, a point (m) of one pair, ``None`` if none do, and these facets."""

    pairs: int
    point: tuple[float, float, float] | None
    facets: frozenset[int] = frozenset()


def find_overlap(surface: Surface) -> Overlap:
    """Find where a boundary on this process passes through itself; not collective.

    Parts that touch, up to 1e-9 of the body's diagonal, do not cross. Curved facets are compared as triangles, at first
    between their nodes, then four times finer: overlaps flatter than what these leave out may go unseen.
    """
    pairs, points = _crossing_facets(surface.cut(surface.degree, np.arange(len(surface.nodes))))
    if len(pairs) and not surface.is_flat:
        pairs, points = _crossing_facets(surface.cut(_FINER * surface.degree, np.unique(pairs)), pairs)
    if not len(pairs):
        return Overlap(0, None)
    x, y, z = points[0].tolist()
    return Overlap(len(pairs), (x, y, z), frozenset(np.unique(pairs).tolist()))


def _crossing_facets(triangles: Triangles, candidate_pairs: Ints | None = None) -> tuple[Ints, Floats]:
    """Distinct pairs of facets with triangles that cross, (n, 2), and a point (n, 3) of each.

    Args:
        candidate_pairs: the distinct pairs of facets (m, 2) that are in question; all if ``None``.
    """
    shrunk = _shrunk(triangles)
    triangle_pairs = meeting(shrunk, triangles.corners)
    if candidate_pairs is not None:
        triangle_pairs = triangle_pairs[
            find_rows(np.sort(triangles.facet[triangle_pairs], axis=1), candidate_pairs) >= 0
        ]
    pairs, points = [np.zeros((0, 2), dtype=np.int64)], [np.zeros((0, 3))]
    for i, j in (part.T for part in np.array_split(triangle_pairs, 1 + len(triangle_pairs) // _CHUNK)):
        crosses, where = crossing(shrunk, triangles.corners[i], triangles.corners[j])
        pairs.append(np.sort(triangles.facet[np.stack([i[crosses], j[crosses]], axis=1)], axis=1))
        points.append(where[crosses])
    distinct, place = unique_rows(np.concatenate(pairs))
    positions = np.empty((len(distinct), 3))
    positions[place] = np.concatenate(points)
    return distinct, positions


def _shrunk(triangles: Triangles) -> Floats:
    """Return the points of a surface, each moved into the body by a slightly different small distance.

    Parts that touch are apart then, those that overlap still do, and none of them lie edge on edge or face in face any
    more, where no edge goes through the inside of a triangle.

    A point moves by ``-h d`` with ``n·d = 1`` for the normals n of the triangles around it, as well as that is possible
    (least squares): so it moves away from each of their planes, also at sharp edges.
    """
    points, corners = triangles.points, triangles.corners
    a, b, c = (points[corners[:, k]] for k in range(3))
    shortest = min(float(np.linalg.norm(q - p, axis=1).min()) for p, q in ((a, b), (b, c), (c, a)))
    hair = min(_TOUCH * float(np.linalg.norm(np.ptp(points, axis=0))), _OF_EDGE * shortest)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    total, dyads = np.zeros_like(points), np.tile(_FLAT * np.eye(3), (len(points), 1, 1))
    for k in range(3):
        np.add.at(total, corners[:, k], normals)
        np.add.at(dyads, corners[:, k], normals[:, :, None] * normals[:, None, :])
    inwards = np.linalg.solve(dyads, total[:, :, None])[:, :, 0]
    shrunk: Floats = points - hair * np.random.default_rng(0).uniform(1.0, 2.0, (len(points), 1)) * inwards
    return shrunk


def meeting(points: Floats, corners: Ints) -> Ints:
    """Return the pairs ``i < j`` (n, 2) of triangles whose bounding boxes meet, by DOLFINx's trees of these.

    Args:
        points: corners of the triangles, (k, 3), each of some triangle.
        corners: triangles as rows of ``points``, (m, 3), which must be different in each triangle.
    """
    mesh = dolfinx.mesh.create_mesh(MPI.COMM_SELF, corners, coordinate_element("triangle", 1), points)
    tree = geometry.bb_tree(mesh, 2)
    pairs = np.asarray(mesh.topology.original_cell_index)[geometry.compute_collisions_trees(tree, tree)]
    return np.asarray(pairs[pairs[:, 0] < pairs[:, 1]], dtype=np.int64)


def crossing(points: Floats, first: Ints, second: Ints) -> tuple[npt.NDArray[np.bool_], Floats]:
    """Return, pair by pair, whether an edge of one triangle passes through the interior of the other, and where.

    Two triangles in general position that meet do so on a segment; each of its ends is such a point. A shared
    corner does not count, nor does a shared edge if the segment lies on it.

    Args:
        points: corners of the triangles, (n, 3).
        first, second: triangles as rows of ``points``, (m, 3).

    Returns:
        Whether they cross (m,), and a point (m, 3) where they do, NaN elsewhere.
    """
    crosses, where = np.zeros(len(first), dtype=bool), np.full((len(first), 3), np.nan)
    shared = (first[:, :, None] == second[:, None, :]).sum(axis=(1, 2))
    left = np.flatnonzero(shared <= 1)
    for cutting, pierced_side in ((first, second), (second, first)):
        left = left[_straddles(points, cutting[left], pierced_side[left])]
    for cutting, pierced_side in ((first, second), (second, first)):
        for p, q in _EDGES:
            pierced, positions = _pierces(points, cutting[left, p], cutting[left, q], pierced_side[left])
            rows = left[pierced]
            crosses[rows], where[rows] = True, positions[pierced]
    return crosses, where


def _straddles(points: Floats, base: Ints, tested: Ints) -> npt.NDArray[np.bool_]:
    """Return whether corners of ``tested`` lie on both sides of the plane of ``base``."""
    a, b, c = (points[base[:, k]] for k in range(3))
    heights = np.einsum("nki,ni->nk", points[tested] - a[:, None], np.cross(b - a, c - a))
    heights[(tested[:, :, None] == base[:, None, :]).any(axis=2)] = 0.0
    return np.asarray((heights.min(axis=1) < 0) & (heights.max(axis=1) > 0))


def _pierces(points: Floats, p: Ints, q: Ints, triangle: Ints) -> tuple[npt.NDArray[np.bool_], Floats]:
    """Return whether the edge from ``p`` to ``q`` passes through the interior of a triangle, and where."""
    apart = ((p[:, None] != triangle) & (q[:, None] != triangle)).all(axis=1)
    a, b, c = (points[triangle[:, k]] for k in range(3))
    start, end = points[p], points[q]
    start_volume, end_volume = _volume(a, b, c, start), _volume(a, b, c, end)
    side_volumes = np.stack([_volume(start, end, *side) for side in ((a, b), (b, c), (c, a))], axis=1)
    is_inside = (side_volumes > 0).all(axis=1) | (side_volumes < 0).all(axis=1)
    pierces = apart & (((start_volume > 0) & (end_volume < 0)) | ((start_volume < 0) & (end_volume > 0))) & is_inside
    share = np.divide(start_volume, start_volume - end_volume, out=np.zeros_like(start_volume), where=pierces)
    return pierces, start + share[:, None] * (end - start)


def _volume(a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
    """Return six times the signed volume of tetrahedra, from differences of coordinates to limit cancellation."""
    volume: Floats = np.einsum("ni,ni->n", np.cross(b - a, c - a), d - a)
    return volume
