"""Walls around a cavity in a segmented image: the cavity is meshed with the wall, whose surfaces it distinguishes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from hpcinv.errors import MeshError
from hpcinv.geometry.imaging.image_mesh import image_mesh
from hpcinv.geometry.imaging.label_image import read_labels
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh.source import Floats, Group, Ints, MeshSource
from hpcinv.mesh.topology import FacetTable, connected

WALL, CAVITY = "wall", "cavity"
_SPECK = 0.05  # area of an opening that is a leak of the segmentation, relative to the largest opening
_FACING = 0.5  # cosine of the angle between a facet at an end of the wall and the opening next to it
_FINENESS = (1.0, 2.0)
"""of the lattice: the second is for walls in which the first has a hole. A finer one takes 8 times as long"""
_REACH = 0.75  # distance of the wall's ends from the plane of an opening, relative to the size of cells


def hollow_wall_mesh(
    path: Path,
    labels: Mapping[str, Sequence[int]],
    size: float,
    unit: float,
    ends: Sequence[str],
    inner: str,
    outer: str,
    report: Callable[[str], None],
) -> MeshSource:
    """Mesh the wall around a cavity on this process, in metres, in cells of second degree.

    Where the cavity ends at the outside or at the border of the image it is open: the wall's facets around an opening
    are one of its ends. The surface at the cavity is ``inner``, all others are ``outer``.

    Args:
        labels: numbers of the voxels of `WALL` and `CAVITY`.
        ends: names of the ends. One or two are in the order of their position along the last axis of the image's
            frame, the highest one last; of more, the first is the largest, and the others are in that order.
        inner, outer: names of the other two surfaces.

    Raises:
        MeshError: as `image_mesh`, or if the wall has another number of ends, or a hole.
        SystemPartMissing: the packages for images are not installed.
    """
    numbers = {name: tuple(values) for name, values in labels.items()}
    spec = MeshSpec.model_construct(file=str(path), labels=numbers, size=size, unit=unit, geometry_degree=2)
    for fineness in _FINENESS:
        mesh = image_mesh(path, spec, report, fineness)
        wall = _wall(path, mesh, size, ends, inner, outer)
        meeting = _meeting(wall, inner, outer)
        if not len(meeting):
            return wall
        place = ", ".join(f"{c:.3g}" for c in meeting.mean(axis=0))
        report(f"'{inner}' and '{outer}' touch near ({place}) m")
    raise MeshError(
        f"{path}: the wall has a hole, or no thickness, near ({place}) m: '{inner}' touches '{outer}'",
        "Close the wall in the segmentation, or take smaller cells (--size).",
    )


def _meeting(wall: MeshSource, inner: str, outer: str) -> Floats:
    """Return the points (n, 3) m that both surfaces of a wall have."""
    surfaces = {group.name: wall.facets[group.members] for group in wall.groups if group.dim == 2}
    return wall.points[np.intersect1d(surfaces[inner], surfaces[outer])]


def _wall(path: Path, mesh: MeshSource, size: float, ends: Sequence[str], inner: str, outer: str) -> MeshSource:
    """Return the wall in a mesh of wall and cavity, with its surfaces; arguments as above."""
    regions = {group.name: group.members for group in mesh.groups if group.dim == 3}
    normals, middles, areas = _geometry(mesh.points, mesh.facets)
    wall_cell, cavity_cell = (_cell_behind(mesh, regions[name]) for name in (WALL, CAVITY))
    is_inner = (wall_cell >= 0) & (cavity_cell >= 0)
    is_opening, is_outer = (cavity_cell >= 0) & ~is_inner, (wall_cell >= 0) & ~is_inner
    for cells, facets in ((wall_cell, is_outer), (cavity_cell, is_opening)):
        _turn_outwards(mesh, cells, facets, normals, middles)
    openings = _pieces(mesh.facets, np.flatnonzero(is_opening), areas)
    if not is_inner.any() or len(openings) != len(ends):
        raise opening_error(path, len(openings), f"{len(ends)} {'is' if len(ends) == 1 else 'are'} needed")
    weighted = np.array([np.average(middles[o], axis=0, weights=areas[o]) for o in openings])
    is_end, surfaces = np.zeros(len(areas), dtype=bool), list[tuple[str, Ints]]()
    for members, middle in zip(openings, weighted, strict=True):
        axis = np.average(normals[members], axis=0, weights=areas[members])
        axis /= np.linalg.norm(axis)
        height = (middles - middle) @ axis
        is_end |= is_outer & (normals @ axis > _FACING) & (np.abs(height) < _REACH * size)
    # Edges between the wall's ends and the cavity are rounded, so that some facets face elsewhere.
    lateral = _pieces(mesh.facets, np.flatnonzero(is_outer & ~is_end), areas)
    is_end |= is_outer & ~np.isin(np.arange(len(areas)), max(lateral, key=len, default=[]))
    places = weighted[_order(weighted, [float(areas[members].sum()) for members in openings])]
    nearest = np.argmin(np.linalg.norm(middles - places[:, None], axis=2), axis=0)
    for place, name in enumerate(ends):
        if not len(members := np.flatnonzero(is_end & (nearest == place))):
            raise MeshError(
                f"{path}: the wall has no end around the opening '{name}' of the cavity",
                "Let the labels of wall and cavity end at the same plane.",
            )
        surfaces.append((name, members))
    surfaces += [(inner, np.flatnonzero(is_inner)), (outer, np.flatnonzero(is_outer & ~is_end))]
    return _only(mesh, regions[WALL], surfaces)


def _turn_outwards(
    mesh: MeshSource, cells: Ints, chosen: npt.NDArray[np.bool_], normals: Floats, middles: Floats
) -> None:
    """Turn the normals of chosen facets away from the cells behind them."""
    cell_middles = mesh.points[mesh.cells[cells[chosen]]].mean(axis=1)
    wrong = np.einsum("ij,ij->i", normals[chosen], middles[chosen] - cell_middles) < 0
    normals[np.flatnonzero(chosen)[wrong]] *= -1


def _order(middles: Floats, areas: Sequence[float]) -> list[int]:
    """Return the openings from below, of more than two the largest before the others."""
    order = [int(number) for number in np.argsort(middles[:, 2])]
    if len(order) > 2:
        largest = max(order, key=areas.__getitem__)
        order.sort(key=lambda number: number != largest)
    return order


def opening_error(path: Path, count: int, needed: str) -> MeshError:
    """Return the error of a cavity with another number of openings than is needed."""
    are = "opening" if count == 1 else "openings"
    return MeshError(
        f"{path}: the cavity has {count} {are} at the outside or the border, but {needed}",
        "Let the label of the cavity end where the wall does, and nowhere else.",
    )


def opening_count(path: Path, labels: Mapping[str, Sequence[int]], unit: float) -> int:
    """Return the number of openings of the cavity in an image, where its voxels end at no wall.

    Specks are left out, as in the mesh. Errors are as in `read_labels`.
    """
    image = read_labels(path, labels, unit)
    numbers = {name: place for place, name in enumerate(labels, start=1)}
    cavity = np.pad(image.voxels == numbers[CAVITY], 1)
    closed = np.pad(image.voxels == numbers[WALL], 1) | cavity
    faces = np.zeros(cavity.shape)
    for axis in range(3):
        area = float(np.delete(image.spacing, axis).prod())
        for step in (-1, 1):
            faces += area * (cavity & ~np.roll(closed, step, axis))
    pieces, count = ndimage.label(faces > 0, np.ones((3, 3, 3)))
    if not count:
        return 0
    areas = ndimage.sum_labels(faces, pieces, np.arange(1, count + 1))
    return int(np.count_nonzero(areas > _SPECK * areas.max()))


def wall_size(path: Path, labels: Mapping[str, Sequence[int]], unit: float) -> tuple[float, float]:
    """Return the typical thickness (m) of the wall in an image, and its volume (m³).

    The thickness is twice the depth that a tenth of the voxels exceed. Errors are as in `read_labels`.
    """
    image = read_labels(path, labels, unit)
    wall = image.voxels == list(labels).index(WALL) + 1
    # At the border of the image the wall goes on.
    depth = ndimage.distance_transform_edt(np.pad(wall, 1, mode="edge"), sampling=image.spacing)[1:-1, 1:-1, 1:-1]
    return 2 * float(np.quantile(depth[wall], 0.9)), float(np.count_nonzero(wall) * image.spacing.prod())


def _geometry(points: Floats, facets: Ints) -> tuple[Floats, Floats, Floats]:
    """Return unit normals of either sign (n, 3), middles (n, 3) and areas (n,) of triangles."""
    a, b, c = (points[facets[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    return normals / lengths[:, None], (a + b + c) / 3, lengths / 2


def _cell_behind(mesh: MeshSource, cells: Ints) -> Ints:
    """Return the one of these cells that each facet of the mesh belongs to, or -1."""
    table = FacetTable.build(mesh.kind, mesh.cells[cells, :4])
    owner = np.full(len(table.vertices) + 1, -1)  # the last entry is for facets of other cells
    owner[table.cell_facets] = cells[:, None]
    return np.asarray(owner[table.find(mesh.facets[:, :3])])


def _pieces(facets: Ints, members: Ints, areas: Floats) -> list[Ints]:
    """Return the connected parts of some facets, without specks."""
    if not len(members):
        return []
    piece = connected(facets[members, :3], int(facets.max()) + 1)
    parts = [members[piece == i] for i in range(piece.max() + 1)]
    largest = max(areas[part].sum() for part in parts)
    return [part for part in parts if areas[part].sum() > _SPECK * largest]


def _only(mesh: MeshSource, cells: Ints, surfaces: Sequence[tuple[str, Ints]]) -> MeshSource:
    """Return some cells of a mesh as a wall, with these facets as its surfaces."""
    groups = [Group(WALL, 3, 1, cells)]
    groups += [Group(name, 2, tag, members) for tag, (name, members) in enumerate(surfaces, start=2)]
    facets = np.sort(np.concatenate([members for _, members in surfaces]))
    return replace(mesh, groups=tuple(groups)).select(np.unique(mesh.cells[cells]), cells, facets)
