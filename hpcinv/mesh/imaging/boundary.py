"""Nodes between labels moved to smooth boundaries, which keep the volume of each label's voxels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from hpcinv.mesh.imaging.lattice import Lattice, interfaces, scaled_jacobians
from hpcinv.mesh.source import Floats, Ints

_ROUNDS = 6
ROUGH, GOOD = 0.03, 0.1
"""Scaled Jacobian that moving nodes leaves to each cell: to those that will be improved, and to the final ones."""
_ALLOWED = 0.7  # share that is left to cells which are worse already


class Memberships:
    """How much each point belongs to each label: indicators of the voxels, smoothed over about half a cell.

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

    def at(self, points: Floats) -> Floats:
        """Memberships (labels, n) at points (n, 3) in m from the first voxel's middle."""
        places = (points / self.spacing).T
        return np.array([ndimage.map_coordinates(f, places, order=1, mode="nearest") for f in self._fields])

    def likeliest(self, x: float, y: Floats, z: Floats) -> Ints:
        """The label (ny, nz) of the largest membership in the plane ``x``, at coordinates ``y`` and ``z``."""
        points = np.stack(np.meshgrid([x], y, z, indexing="ij"), axis=-1)
        return np.asarray(self.at(points.reshape(-1, 3)).argmax(axis=0).reshape(len(y), len(z)))

    def difference(self, points: Floats, one: Ints, other: Ints) -> Floats:
        """Membership of label ``one`` less that of ``other``, for each point."""
        found, rows = self.at(points), np.arange(len(points))
        return np.asarray(found[one, rows] - found[other, rows])


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
    count = len(volumes) + 1
    touches = np.zeros((len(lattice.points), count), dtype=bool)
    for corner in range(3):
        touches[facets[:, corner], pairs[:, 0]] = touches[facets[:, corner], pairs[:, 1]] = True
    nodes = np.flatnonzero(touches.sum(axis=1) == 2)  # where three labels meet, nodes stay
    one = touches[nodes].argmax(axis=1)
    other = count - 1 - touches[nodes][:, ::-1].argmax(axis=1)
    outward = np.zeros(count)  # distance by which each label grows; between two labels, half of it
    moved = lattice.points
    for _ in range(_ROUNDS):
        shift = np.where(one == 0, outward[other], 0.5 * (outward[other] - outward[one]))
        moved = _moved(lattice, memberships, spacing, nodes, (one, other), shift, least)
        cells = lattice.volumes(moved)
        areas = _areas(moved, facets)
        for label in range(1, count):
            to_outside = (pairs[:, 0] == 0) & (pairs[:, 1] == label)
            to_others = (pairs == label).any(axis=1) & ~to_outside
            area = areas[to_outside].sum() + 0.5 * areas[to_others].sum()
            missing = volumes[label - 1] - cells[lattice.labels == label].sum()
            outward[label] += np.clip(missing / area, -0.25 * spacing, 0.25 * spacing)
    return moved


def _moved(
    lattice: Lattice,
    memberships: Memberships,
    spacing: float,
    nodes: Ints,
    labels: tuple[Ints, Ints],
    shift: Floats,
    least: float,
) -> Floats:
    """Move nodes to where both labels are equally likely, and by a shift from there into the first of them."""
    one, other = labels
    start = lattice.points[nodes]
    points = start.copy()
    for _ in range(6):
        value = memberships.difference(points, one, other)
        slope = np.stack(
            [
                memberships.difference(points + step, one, other) - memberships.difference(points - step, one, other)
                for step in 0.25 * spacing * np.eye(3)
            ],
            axis=1,
        ) / (0.5 * spacing)
        size = np.linalg.norm(slope, axis=1) + 1e-12 / spacing
        distance = np.clip(value / size, -spacing, spacing) - shift
        points = points - 0.8 * distance[:, None] * slope / size[:, None]
        step = points - start
        length = np.linalg.norm(step, axis=1)
        points = start + step * np.minimum(1.0, 0.6 * spacing / np.maximum(length, 1e-12 * spacing))[:, None]
    target = lattice.points.copy()
    target[nodes] = points
    is_moved = np.zeros(len(target), dtype=bool)
    is_moved[nodes] = True
    cells = lattice.cells[is_moved[lattice.cells].any(axis=1)]
    share = np.ones(len(target))
    floor = np.minimum(least, _ALLOWED * scaled_jacobians(lattice.points[cells]))
    for _ in range(30):
        moved = lattice.points + share[:, None] * (target - lattice.points)
        if not (bad := scaled_jacobians(moved[cells]) < floor).any():
            return moved
        share[np.unique(cells[bad])] *= 0.7
    return lattice.points


def _areas(points: Floats, facets: Ints) -> Floats:
    a, b, c = (points[facets[:, i]] for i in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)
