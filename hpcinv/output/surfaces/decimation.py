"""A coarser surface with some of the points of a large one, for pictures that must stay small."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hpcinv.base.quantity.arrays import Floats, Ints

MOST = 25_000
"""largest number of points of a surface that is kept as it is"""
_ROUNDS = 12  # of the search for the size of the clusters


@dataclass(frozen=True)
class Decimated:
    """Part of a surface.

    Attributes:
        points: rows of the points that are kept, in order, (n,).
        triangles: rows of ``points``, (m, 3).
        rows: the original triangle whose values each triangle has, (m,).
    """

    points: Ints
    triangles: Ints
    rows: Ints


def decimated(points: Floats, triangles: Ints, most: int = MOST) -> Decimated:
    """Return at most ``most`` points of a surface, and triangles between them; the same for the same input.

    Points in one cube of a grid whose normals point to the same side become the one of them that is nearest to their
    mean, so that the two sides of a thin wall stay apart.

    Source: Rossignac & Borrel, "Multi-resolution 3D approximations for rendering complex scenes" (1993),
    doi:10.1007/978-3-642-78114-8_29.
    """
    if len(points) <= most:
        return Decimated(np.arange(len(points)), triangles, np.arange(len(triangles)))
    side = _sides(points, triangles)
    low, high = points.min(axis=0), float(np.ptp(points, axis=0).max())
    fine, coarse = high / 2_000, high  # sizes of cubes: of too many points, and of few enough
    for _ in range(_ROUNDS):
        size = np.sqrt(fine * coarse)
        if len(np.unique(_cubes(points, low, size, side))) > most:
            fine = size
        else:
            coarse = size
    _, cluster = np.unique(_cubes(points, low, coarse, side), return_inverse=True)
    count = np.bincount(cluster)
    mean = np.stack([np.bincount(cluster, points[:, i]) / count for i in range(3)], axis=1)
    distance = np.linalg.norm(points - mean[cluster], axis=1)
    order = np.lexsort((np.arange(len(points)), distance, cluster))
    kept = order[np.unique(cluster[order], return_index=True)[1]]
    new = np.empty(len(kept), dtype=np.int64)
    rows = np.argsort(kept)
    new[rows] = np.arange(len(kept))
    corners = new[cluster][triangles]
    a, b, c = corners.T
    whole = np.flatnonzero((a != b) & (b != c) & (c != a))
    _, first = np.unique(np.sort(corners[whole], axis=1), axis=0, return_index=True)
    chosen = whole[np.sort(first)]
    return Decimated(kept[rows], corners[chosen], chosen)


def _sides(points: Floats, triangles: Ints) -> npt.NDArray[np.int64]:
    """Number of the axis and sign that the normal at each point is nearest to, 0 to 5."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    total = np.stack(
        [sum(np.bincount(triangles[:, k], normals[:, i], len(points)) for k in range(3)) for i in range(3)], axis=1
    )
    axis = np.abs(total).argmax(axis=1)
    return np.asarray(2 * axis + (total[np.arange(len(points)), axis] > 0))


def _cubes(points: Floats, low: Floats, size: float, side: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    place = np.floor((points - low) / size).astype(np.int64)
    counts = place.max(axis=0) + 1
    return np.asarray(((place[:, 0] * counts[1] + place[:, 1]) * counts[2] + place[:, 2]) * 6 + side)
