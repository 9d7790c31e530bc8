"""Nodes between labels moved to smooth boundaries, which keep the volume of each label's voxels."""

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from hpcinv.geometry.imaging.lattice import Lattice, interfaces, scaled_jacobians
from hpcinv.mesh.source import Floats, Ints

_ROUNDS = 6
_STEPS = 6  # of Newton's method to the boundary
ROUGH, GOOD = 0.03, 0.1
"""Scaled Jacobian that moving nodes leaves to each cell: to those that will be improved, and to the final ones."""
_ALLOWED = 0.7  # share that is left to cells which are worse already


class Memberships:
    """Membership of each point in each label: indicators of the voxels, smoothed over about half a cell.

    Args:
        voxels: labels, (nx, ny, nz), 0 on all sides.
        count: number of labels, without the outside.
        spacing: of the voxels (m), (3,).
        width: standard deviation (m) of the smoothing.
    """

    def __init__(self, voxels: Ints, count: int, spacing: Floats, width: float) -> None:
        self.spacing = spacing
        sigma = np.maximum(width / spacing, 0.5)
        self._fields = [
            ndimage.gaussian_filter((voxels == label).astype(np.float32), sigma) for label in range(count + 1)
        ]

    def evaluate(self, points: Floats) -> Floats:
        """Memberships (labels, n) at points (n, 3) in m from the first voxel's middle."""
        places = (points / self.spacing).T
        return np.array([ndimage.map_coordinates(f, places, order=1, mode="nearest") for f in self._fields])

    def likeliest(self, x: float, y: Floats, z: Floats) -> Ints:
        """The label (ny, nz) of the largest membership in the plane ``x``, at coordinates ``y`` and ``z``."""
        points = np.stack(np.meshgrid([x], y, z, indexing="ij"), axis=-1)
        return np.asarray(self.evaluate(points.reshape(-1, 3)).argmax(axis=0).reshape(len(y), len(z)))

    def difference(self, points: Floats, lower: Ints, upper: Ints) -> Floats:
        """Membership of label ``lower`` less membership of ``upper``, for each point."""
        memberships, rows = self.evaluate(points), np.arange(len(points))
        return np.asarray(memberships[lower, rows] - memberships[upper, rows])

    def nearest(self, points: Floats, lower: Ints, upper: Ints, reach: float) -> tuple[Floats, Floats]:
        """Points (n, 3) near to the given ones where two labels are equally likely, and normals (n, 3) from ``upper``
        into ``lower``.

        Args:
            reach: largest distance (m) from the given points.
        """
        boundary_points, steps = points, 0.25 * reach * np.eye(3)
        for _ in range(_STEPS):
            slope = np.stack(
                [
                    self.difference(boundary_points + step, lower, upper)
                    - self.difference(boundary_points - step, lower, upper)
                    for step in steps
                ],
                axis=1,
            ) / (0.5 * reach)
            size = np.linalg.norm(slope, axis=1) + 1e-12 / reach
            distance = np.clip(self.difference(boundary_points, lower, upper) / size, -reach, reach)
            boundary_points = limit_steps(
                points, boundary_points - 0.8 * distance[:, None] * slope / size[:, None], reach
            )
        return boundary_points, slope / size[:, None]


def smoothed(
    lattice: Lattice, memberships: Memberships, spacing: float, volumes: Sequence[float], least: float
) -> Floats:
    """Return the lattice's points with those between two labels on a smooth boundary; no cell is turned inside out.

    Args:
        spacing: of the lattice.
        volumes: that the labels shall have, of the n-th label at n - 1.
        least: scaled Jacobian below which no cell becomes worse.
    """
    facets, pairs = interfaces(lattice.cells, lattice.labels)
    count, reach = len(volumes) + 1, 0.6 * spacing
    nodes, lower, upper = two_label_nodes(facets, pairs, len(lattice.points), count)
    boundary_points, normals = memberships.nearest(lattice.points[nodes], lower, upper, reach)
    outward, moved = np.zeros(count), lattice.points
    for _ in range(_ROUNDS):
        target = lattice.points.copy()
        shifted = boundary_points + shift(outward, lower, upper)[:, None] * normals
        target[nodes] = limit_steps(lattice.points[nodes], shifted, reach)
        moved, _ = held_back(lattice, nodes, target, least)
        label_volumes = np.bincount(lattice.labels, lattice.volumes(moved), minlength=count)[1:]
        outward += growth(np.array(volumes) - label_volumes, moved, facets, pairs, 0.25 * spacing)
    return moved


def two_label_nodes(facets: Ints, pairs: Ints, points: int, count: int) -> tuple[Ints, Ints, Ints]:
    """Nodes between two labels, and the smaller and the larger one of these labels; where three meet, nodes stay.

    Args:
        facets: nodes of facets between labels, (n, k).
        pairs: these labels, (n, 2).
        points: number of nodes.
        count: of labels, with the outside.
    """
    touches = np.zeros((points, count), dtype=bool)
    for corner in facets.T:
        touches[corner, pairs[:, 0]] = touches[corner, pairs[:, 1]] = True
    nodes = np.flatnonzero(touches.sum(axis=1) == 2)
    return nodes, touches[nodes].argmax(axis=1), count - 1 - touches[nodes][:, ::-1].argmax(axis=1)


def shift(outward: Floats, lower: Ints, upper: Ints) -> Floats:
    """Distance of boundaries into label ``lower`` where labels grow ``outward`` (m); label 0 is the outside."""
    return np.where(lower == 0, outward[upper], 0.5 * (outward[upper] - outward[lower]))


def growth(missing: Floats, points: Floats, facets: Ints, pairs: Ints, most: float) -> Floats:
    """Distances (labels,) by which labels must grow to gain ``missing`` volumes (m³), at most by ``most`` (m)."""
    areas, distances = _areas(points, facets), np.zeros(len(missing) + 1)
    for label in range(1, len(distances)):
        is_outer = (pairs[:, 0] == 0) & (pairs[:, 1] == label)
        is_inner = (pairs == label).any(axis=1) & ~is_outer
        area = areas[is_outer].sum() + 0.5 * areas[is_inner].sum()
        distances[label] = np.clip(missing[label - 1] / area, -most, most)
    return distances


def held_back(lattice: Lattice, nodes: Ints, target: Floats, least: float) -> tuple[Floats, Floats]:
    """Points of the lattice with some nodes on their way to a target (points, 3), and the share of it they went.

    Args:
        least: scaled Jacobian below which no cell becomes worse.
    """
    is_moved = np.zeros(len(target), dtype=bool)
    is_moved[nodes] = True
    cells = lattice.cells[is_moved[lattice.cells].any(axis=1)]
    share = np.ones(len(target))
    floor = np.minimum(least, _ALLOWED * scaled_jacobians(lattice.points[cells]))
    for _ in range(30):
        moved = lattice.points + share[:, None] * (target - lattice.points)
        if not (bad := scaled_jacobians(moved[cells]) < floor).any():
            return moved, share
        share[np.unique(cells[bad])] *= 0.7
    return lattice.points, np.zeros(len(target))


def limit_steps(start: Floats, end: Floats, reach: float) -> Floats:
    """Points on the way from ``start`` to ``end``, at most ``reach`` (m) from the start."""
    step = end - start
    length = np.linalg.norm(step, axis=1)
    return np.asarray(start + step * np.minimum(1.0, reach / np.maximum(length, 1e-12 * reach))[:, None])


def _areas(points: Floats, facets: Ints) -> Floats:
    a, b, c = (points[facets[:, i]] for i in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)
