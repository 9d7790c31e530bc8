"""Tubes around centrelines with radii, which a table gives, joined with rounded edges where branches meet."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyvista

from hpcinv.base.quantity.csv_rows import Row, below_titles, rows_of, text_of
from hpcinv.base.quantity.units import readable
from hpcinv.errors import MeshError
from hpcinv.geometry.imaging.specks import check_extent
from hpcinv.mesh.source import Floats

_ADVICE = "Each line has x, y, z, radius, and with several branches the name of the branch."
_LARGEST = 10_000_000  # bytes of a table
_ALONG = 0.1  # distance of balls along a tube, relative to the radius; raised, tubes become bumpy
_ACROSS = 6  # points of the grid along a radius; fewer make coarse surfaces
_ROUNDED = 0.25  # of the smallest radius: over which edges between branches are rounded
_BEYOND = 0.3  # length by which tubes go on behind their ends, relative to the radius, so that sections are round
_LONGEST = 10_000  # length of a branch, relative to its radius; longer ones take memory before the grid does
_MOST = 30e6  # points of the grid


def read_centrelines(path: Path, unit: float) -> list[Floats]:
    """Read points and radii (n, 4), in m, of each branch.

    Raises:
        MeshError: the table cannot be read, or a branch has no length or no radius.
    """
    branches: dict[str, list[list[float]]] = {}
    try:
        rows = [row for row in rows_of(text_of(path, _LARGEST)) if isinstance(row, Row)]
    except ValueError as error:
        raise MeshError(f"{path}: {error}", _ADVICE) from None
    for row in below_titles(rows, (4, 5)):
        try:
            numbers = _point_of(row, unit)
        except ValueError as error:
            raise MeshError(f"{path}: line {row.line}: {error}", _ADVICE) from None
        branches.setdefault(row.entries[4] if len(row.entries) == 5 else "", []).append(numbers)
    if not branches:
        raise MeshError(f"{path}: has no points", _ADVICE)
    return [_tube(path, name, np.array(points)) for name, points in branches.items()]


def _point_of(row: Row, unit: float) -> list[float]:
    """Return a point and its radius in m; ``ValueError`` if the row has other entries."""
    if len(row.entries) not in (4, 5):
        raise ValueError(f"has {len(row.entries)} entries, not 4 or 5")
    numbers = [row.number(column) * unit for column in range(4)]
    if not np.isfinite(numbers).all() or numbers[3] <= 0:
        raise ValueError("the radius must be above 0 and all numbers finite")
    return numbers


def _tube(path: Path, name: str, points: Floats) -> Floats:
    """Return the distinct points of a branch; ``MeshError`` if it is a point, or too long."""
    tube: Floats = points[np.concatenate([[True], np.any(np.diff(points[:, :3], axis=0) != 0, axis=1)])]
    if len(tube) < 2:
        raise MeshError(f"{path}: the branch '{name}' has fewer than two distinct points", _ADVICE)
    length = float(np.linalg.norm(np.diff(tube[:, :3], axis=0), axis=1).sum())
    if not length < _LONGEST * tube[:, 3].min():
        raise _too_long(path, length, float(tube[:, 3].min()))
    return tube


def surface_of_tubes(
    path: Path, branches: Sequence[Floats], size: float
) -> tuple[pyvista.PolyData, tuple[tuple[Floats, Floats], ...]]:
    """Return the surface (m) around branches, which goes on behind their ends, and the planes of the ends.

    A branch ends openly where no other branch surrounds its last point.
    """
    inner_balls = [_balls(branch) for branch in branches]
    cuts, balls = list[tuple[Floats, Floats]](), list[Floats]()
    for number, branch in enumerate(branches):
        others = [other for i, other in enumerate(inner_balls) if i != number]
        longer = branch
        for step in (1, -1):
            end, inner = branch[::step][0], branch[::step][1]
            if any((np.linalg.norm(other[:, :3] - end[:3], axis=1) < other[:, 3]).any() for other in others):
                continue
            along = (end[:3] - inner[:3]) / np.linalg.norm(end[:3] - inner[:3])
            beyond = np.append(end[:3] + _BEYOND * end[3] * along, end[3])
            longer = np.concatenate([beyond[None], longer] if step > 0 else [longer, beyond[None]])
            cuts.append((end[:3], along))
        balls.append(_balls(longer))
    thinnest = min(float(branch[:, 3].min()) for branch in branches)
    every = np.concatenate(balls)
    low, high = (every[:, :3] - every[:, 3:]).min(axis=0), (every[:, :3] + every[:, 3:]).max(axis=0)
    spacing = min(thinnest / _ACROSS, size)
    counts = np.ceil((high - low) / spacing).astype(int) + 9
    if not float(np.prod(counts, dtype=float)) <= _MOST:
        raise _too_long(path, float((high - low).max()), thinnest)
    check_extent(path, high - low, size, fits=True)
    origin = low - 4 * spacing
    depths = [_depth(tube, origin, counts, spacing) for tube in balls]
    field = depths[0]
    rounded = _ROUNDED * thinnest
    for depth in depths[1:]:  # polynomial smooth maximum
        share = np.clip(0.5 + 0.5 * (depth - field) / rounded, 0, 1)
        field = field + (depth - field) * share + rounded * share * (1 - share)
    grid = pyvista.ImageData(dimensions=counts, spacing=[spacing] * 3, origin=origin)
    grid.point_data["depth"] = field.ravel(order="F")
    surface = grid.contour([0.0], scalars="depth", method="flying_edges").triangulate().clean()
    surface = surface.compute_normals(auto_orient_normals=True, split_vertices=False)
    bare = pyvista.PolyData.from_regular_faces(np.asarray(surface.points, dtype=np.float64), surface.regular_faces)
    return bare, tuple(cuts)


def _too_long(path: Path, length: float, radius: float) -> MeshError:
    text = f"{path}: the vessel of {readable(length, 'm')} is long for its radius of {readable(radius, 'm')}"
    return MeshError(text, "Give less of it, or correct the unit or the radii.")


def _balls(branch: Floats) -> Floats:
    """Return centres and radii of dense balls along a branch."""
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch[:, :3], axis=0), axis=1))])
    count = int(np.ceil(distance[-1] / (_ALONG * float(branch[:, 3].min())))) + 1
    places = np.linspace(0.0, distance[-1], count)
    return np.column_stack([np.interp(places, distance, branch[:, i]) for i in range(4)])


def _depth(balls: Floats, origin: Floats, counts: npt.NDArray[np.int64], spacing: float) -> Floats:
    """Return the depth of the points of a grid in the union of balls, negative outside."""
    depth = np.full(counts, -float(balls[:, 3].max()))
    for x, y, z, radius in balls:
        reach = radius * 1.5 + 2 * spacing
        begin = np.maximum(np.ceil((np.array([x, y, z]) - reach - origin) / spacing).astype(int), 0)
        stop = np.minimum(np.floor((np.array([x, y, z]) + reach - origin) / spacing).astype(int) + 1, counts)
        axes = [origin[i] + spacing * np.arange(begin[i], stop[i]) for i in range(3)]
        squares = (
            (axes[0] - x)[:, None, None] ** 2 + (axes[1] - y)[None, :, None] ** 2 + (axes[2] - z)[None, None, :] ** 2
        )
        part = depth[tuple(map(slice, begin, stop))]
        np.maximum(part, radius - np.sqrt(squares), out=part)
    return depth
