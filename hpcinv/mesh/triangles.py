"""Pairs of triangles in space: those whose bounding boxes meet, and those that intersect."""

import dolfinx
import numpy as np
import numpy.typing as npt
from dolfinx import geometry

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.cells import coordinate_element
from hpcinv.mesh.source import Floats, Ints

_EDGES = ((0, 1), (1, 2), (2, 0))


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
