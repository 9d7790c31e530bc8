"""Size of cells graded to the thickness of walls: at least two cells through each, as far as their number allows."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from hpcinv.geometry.imaging.label_boundary import Memberships
from hpcinv.mesh.source import Floats, Ints

_MOST_SAMPLES = 30_000
_SMOOTH = 0.7  # standard deviation of the smoothing of voxels for directions of rays, in voxels
_NEAR = 7  # samples of whose thicknesses the middle one is taken
_GROWTH = 0.3  # of the size per distance from the boundary
_RATIO = 4.0  # of the largest size and the smallest one, unless it is given
_LEAST = 0.2  # size at strong curvatures, relative to the largest one, unless the ratio is given
_MORE = 4.0  # times as many cells as without grading, at most, unless the ratio is given
_FACES = 2 / 3  # area of a smooth surface, relative to the area of the faces of its voxels


@dataclass(frozen=True)
class WallSizes:
    """Size of cells at each place.

    Attributes:
        size: largest one (m).
        floor: smallest one in walls (m).
        least: smallest one at all, as at strong curvatures (m).
        thickness: of walls at samples of the boundary (m), at most twice ``size``.
        points: of these samples, (n, 3).
    """

    size: float
    floor: float
    least: float
    thickness: Floats
    points: Floats

    @property
    def is_graded(self) -> bool:
        """True if some walls are too thin for two cells of the largest size."""
        return self.floor < self.size and self.share_of_walls > 0

    @property
    def share_of_walls(self) -> float:
        """Share of the boundary at walls that are too thin for two cells of the largest size."""
        return float((self.thickness < 2 * self.size).mean()) if len(self.thickness) else 0.0

    @property
    def share_too_thin(self) -> float:
        """Share of the boundary at walls that are too thin for two cells of the smallest size."""
        return float((self.thickness < 1.8 * self.floor).mean()) if len(self.thickness) else 0.0

    @property
    def thinnest(self) -> float:
        """Thickness (m) below which a twentieth of the boundary is."""
        return float(np.quantile(self.thickness, 0.05)) if len(self.thickness) else np.inf

    def interpolate(self, points: Floats) -> Floats:
        """Sizes (n,) in m at points (n, 3): half of the thickness of the wall, and growing away from its surface."""
        if not self.is_graded:
            return np.full(len(points), self.size)
        distance, neighbours = KDTree(self.points).query(points, k=3)
        sizes = np.clip(0.5 * self.thickness, self.floor, self.size)[neighbours] + _GROWTH * distance
        return np.asarray(np.minimum(sizes.min(axis=1), self.size))


def wall_sizes(voxels: Ints, spacing: Floats, count: int, size: float, ratio: float | None) -> WallSizes:
    """Measure walls along rays from the boundary into each label, and choose the smallest size of cells.

    Args:
        voxels: labels, (nx, ny, nz), 0 on all sides.
        spacing: of the voxels (m), (3,).
        count: number of labels, without the outside.
        size: largest size (m) of cells.
        ratio: of the largest size and the smallest one; by default at most 4, with four times as many cells at most.
    """
    memberships = Memberships(voxels, count, spacing, _SMOOTH * float(spacing.min()))
    points, lower, upper, area = _samples(voxels, spacing)
    points, normals = memberships.nearest(points, lower, upper, float(spacing.min()))
    rays = [
        (
            points[rows],
            _thickness(memberships, points[rows], turn * normals[rows], label[rows], size, spacing),
            area[rows],
        )
        for label, turn in ((lower, 1.0), (upper, -1.0))
        for rows in [np.flatnonzero(label > 0)]
    ]
    ray_points, thickness, areas = (np.concatenate(parts) for parts in zip(*rays, strict=True))
    _, neighbours = KDTree(ray_points).query(ray_points, k=min(_NEAR, len(ray_points)))
    thickness = np.median(thickness[neighbours.reshape(len(ray_points), -1)], axis=1)
    floor = size / ratio if ratio else _floor(thickness, areas, size, float(np.count_nonzero(voxels) * spacing.prod()))
    return WallSizes(size, floor, floor if ratio else min(floor, _LEAST * size), thickness, ray_points)


def _samples(voxels: Ints, spacing: Floats) -> tuple[Floats, Ints, Ints, Floats]:
    """Middles of faces between voxels of different labels (n, 3), the smaller and the larger label, and areas (m²)."""
    places, pairs, areas = list[Floats](), list[Ints](), list[Floats]()
    for axis in range(3):
        next_voxels = tuple(slice(1, None) if i == axis else slice(None) for i in range(3))
        last_voxels = tuple(slice(None, -1) if i == axis else slice(None) for i in range(3))
        faces = np.argwhere(voxels[last_voxels] != voxels[next_voxels])
        pairs.append(np.stack([voxels[last_voxels][tuple(faces.T)], voxels[next_voxels][tuple(faces.T)]], axis=1))
        places.append((faces + 0.5 * np.eye(3)[axis]) * spacing)
        areas.append(np.full(len(faces), _FACES * float(np.delete(spacing, axis).prod())))
    points, pair, area = np.concatenate(places), np.concatenate(pairs), np.concatenate(areas)
    if len(points) > _MOST_SAMPLES:
        chosen = np.random.default_rng(0).choice(len(points), _MOST_SAMPLES, replace=False)
        points, pair, area = points[chosen], pair[chosen], area[chosen] * (len(points) / _MOST_SAMPLES)
    return points, pair.min(axis=1), pair.max(axis=1), area


def _thickness(
    memberships: Memberships, points: Floats, directions: Floats, label: Ints, size: float, spacing: Floats
) -> Floats:
    """Lengths (n,) of rays in their label, at most twice the size."""
    step = max(0.5 * float(spacing.min()), size / 16)
    steps = max(int(np.ceil(2 * size / step)), 2)
    length, rows = np.full(len(points), steps * step), np.arange(len(points))
    depth = np.zeros(len(points))  # how much likelier the label is than all others
    for i in range(1, steps + 1):
        belongs = memberships.evaluate(points[rows] + i * step * directions[rows])
        own = belongs[label[rows], np.arange(len(rows))].copy()
        belongs[label[rows], np.arange(len(rows))] = -np.inf
        now = own - belongs.max(axis=0)
        left = now < 0
        last_depth = np.maximum(depth[rows[left]], 0)
        length[rows[left]] = step * (i - 1 + last_depth / (last_depth - now[left]))
        depth[rows] = now
        rows = rows[~left]
        if not len(rows):
            break
    return np.asarray(np.clip(length, step, 2 * size))


def _floor(thickness: Floats, areas: Floats, size: float, volume: float) -> float:
    """Smallest size for which there are not too many more cells than of the largest one, with two through each wall."""
    deep = 0.5 * areas * thickness  # volumes below samples
    rest = max(volume - float(deep.sum()), 0.0) / size**3
    for ratio in np.linspace(_RATIO, 1.0, 13):
        sizes = np.clip(0.5 * thickness, size / ratio, size)
        flat = np.minimum(0.5 * thickness, size)
        uniform_count = rest + float(np.sum(deep / (size**2 * flat)))
        if rest + float(np.sum(deep / (sizes**2 * np.minimum(flat, sizes)))) <= _MORE * uniform_count:
            break
    return float(size / ratio)
