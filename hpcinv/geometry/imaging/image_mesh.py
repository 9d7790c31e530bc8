"""From a segmented image or a closed surface to a mesh, with a region for each label and for each pair that touch."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyvista
from scipy import ndimage

from hpcinv.base.parallel.signals import handlers_restored
from hpcinv.base.quantity.arrays import Booleans
from hpcinv.base.quantity.units import readable
from hpcinv.errors import MeshError
from hpcinv.geometry.imaging.clean_surfaces import MMG, cells_between_surfaces
from hpcinv.geometry.imaging.closed_surface import fill
from hpcinv.geometry.imaging.curved_cells import SmoothBoundary, curved
from hpcinv.geometry.imaging.image_files import package
from hpcinv.geometry.imaging.label_boundary import GOOD, ROUGH, Memberships, limit_steps, smoothed
from hpcinv.geometry.imaging.label_image import LabelImage, read_labels
from hpcinv.geometry.imaging.lattice import Lattice, drop_outside, interfaces, lattice_of
from hpcinv.geometry.imaging.mesh_report import report_distance, report_mesh, report_sizes
from hpcinv.geometry.imaging.specks import check_extent, check_thickness, remove_specks, represented_volumes
from hpcinv.geometry.imaging.surroundings import OUTSIDE, NameArray, surroundings
from hpcinv.geometry.imaging.wall_sizes import WallSizes, wall_sizes
from hpcinv.job.mesh_file import CUT
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh.cells import mirrored
from hpcinv.mesh.crossing_facets import find_overlap
from hpcinv.mesh.source import Floats, Group, Ints, MeshSource
from hpcinv.mesh.surface import Surface

_FINE = 0.5  # spacing of the lattice, relative to the size of cells
_FINEST = 0.75  # the same, relative to the voxels: below that there is nothing to see
_MOST_FIT = 5e6  # cubes of the cells' size in a box around the body: there is memory for them
_RIGHT = 0.01  # relative error of a volume up to which it is not noted
_GAPS = 2  # cells of the lattice: half of the width of gaps in which cells outside the body keep surfaces apart
_REACHES = (2, 6, 10_000)  # cells of the lattice: distances from crossing facets, tried in turn, up to which others do
_UNIFORM = 0.6  # smallest size of cells of one size, relative to the largest one
_LEAST_LATTICE = 20_000  # tetrahedra, unless voxels are larger: more take longer, fewer make surfaces rough for MMG
_MOST_LATTICE = 1_500_000  # tetrahedra, unless the size of cells needs more
_PASSES = 2  # of MMG, each with nodes moved to the boundary after it
_WRONG = 0.1  # relative error of a volume from which on there is no mesh
_WITHIN = 0.25  # distance by which MMG may move boundaries, relative to the voxels of an image
_WITHIN_FILLED = 0.4  # this distance for a surface that was filled with voxels
_NEXT = 2.5  # distance of a neighbour's voxels from facets next to it, relative to a voxel
_CELLS = 3e-2  # volume of a tetrahedron, relative to the cube of its size, for the expected number


@dataclass(frozen=True)
class _Cubes:
    """Labelled cubes of a lattice, and what the cells that are made of them have to keep.

    Attributes:
        path: of the image or surface, for messages.
        labels: of the cubes, (nx, ny, nz), 0 on all sides.
        begin: corner of the first cube (m).
        spacing: of the cubes (m).
        volumes: of the labels (m³).
        tolerance: largest distance (m) by which MMG may move boundaries.
    """

    path: Path
    labels: Ints
    begin: Floats
    spacing: float
    memberships: Memberships
    sizes: WallSizes
    volumes: Sequence[float]
    tolerance: float


def image_mesh(path: Path, spec: MeshSpec, report: Callable[[str], None], fineness: float = 1.0) -> MeshSource:
    """Mesh a segmented image on this process, in metres.

    Regions are the labels; ``A|B`` and ``A|outside``, the facets between labels; ``A|cavity``, ``A|cavity-2`` and so
    on, boundaries of closed cavities, the largest first; and ``cut``, where a label ends at the image's border.

    Args:
        report: called with what a user should know.
        fineness: divisor of the lattice's spacing; above 1, thinner walls are kept, which takes longer.

    Raises:
        MeshError: the image cannot be read, lacks a label, or its labels are too thin for cells.
        SystemPartMissing: the packages for images are not installed.
    """
    assert spec.size is not None
    image = read_labels(path, spec.labels, spec.metres, spec.orientation, spec.neighbours)
    low, high = _box(image)
    extent = (high - low) * image.spacing
    check_extent(path, extent, spec.size, fits=float(np.prod(extent / spec.size)) <= _MOST_FIT)
    check_thickness(image, report)
    image = remove_specks(image, spec.size, report)
    volumes = [image.volume(label) for label in range(1, len(spec.labels) + 1)]
    mesh = _meshed(image, spec, volumes, _WITHIN, report, fineness=fineness)
    return replace(mesh, voxel=float(image.spacing.prod() ** (1 / 3)))


def surface_mesh(parts: Mapping[str, Sequence[Path]], spec: MeshSpec, report: Callable[[str], None]) -> MeshSource:
    """Mesh the body in closed surfaces (STL, PLY, OBJ, VTP) on this process, in metres.

    Regions are ``parts``, by the files of their surfaces, and their surfaces. Errors are as in `image_mesh`.
    """
    assert spec.size is not None
    image, volumes, surface = fill(parts, spec.size, spec.metres)
    return _meshed(image, spec, volumes, _WITHIN_FILLED, report, surface)


def _meshed(
    image: LabelImage,
    spec: MeshSpec,
    volumes: Sequence[float],
    tolerance: float,
    report: Callable[[str], None],
    surface: pyvista.PolyData | None = None,
    *,
    fineness: float = 1.0,
) -> MeshSource:
    """Mesh labels.

    Args:
        volumes: of the labels, which the mesh keeps.
        tolerance: largest distance by which MMG may move boundaries, in voxels.
        surface: triangles (m) that the voxels were made from; nodes of cells of second degree lie on them.
    """
    cubes, first = _cubes(image, spec, volumes, tolerance, report, fineness)
    cells, points, crossing, least = _cells(cubes, report)
    if len(crossing):
        x, y, z = image.positions(crossing[:1] + first * image.spacing)[0]
        report(f"{len(crossing)} facets of the surface cross others, such as at ({x:.4g}, {y:.4g}, {z:.4g}) m")
    facets, pairs = interfaces(cells.cells, cells.labels)
    is_cut = _is_at_border(points, facets, first, image)
    reach = max(_NEXT * float(image.spacing.max()), _FINE * cubes.sizes.size)
    names = surroundings(points, facets, pairs, image, first, reach)
    mesh = MeshSource(
        path=image.path,
        kind="tetrahedron",
        degree=1,
        points=points,
        node_tags=np.arange(1, len(points) + 1),
        cells=cells.cells,
        cell_tags=np.arange(1, len(cells.cells) + 1),
        facets=facets,
        groups=_groups(image.names, cells.labels, pairs, is_cut, names),
    )
    errors = _volume_errors(points, cells, cubes.volumes)
    if spec.geometry_degree == 2:
        boundary: SmoothBoundary = cubes.memberships
        if surface is not None:
            start = image.origin + first * image.spacing
            boundary = GivenSurface(surface.translate(-start), cubes.memberships)
        mesh, errors = curved(mesh, cells.labels, pairs, boundary, cubes.spacing, cubes.volumes, least, report)
    _tell_volumes(image, cubes.volumes, errors, report)
    mesh = replace(mesh, points=image.positions(mesh.points + first * image.spacing))
    if np.linalg.det(image.axes) < 0:
        mesh = replace(mesh, cells=mirrored(mesh.kind, mesh.degree, mesh.cells))
    report_mesh(mesh, image.frame, report)
    report_sizes(mesh, cubes.sizes, report)
    if surface is not None:
        report_distance(mesh, surface, report)
    return mesh


def _cubes(
    image: LabelImage,
    spec: MeshSpec,
    volumes: Sequence[float],
    tolerance: float,
    report: Callable[[str], None],
    fineness: float,
) -> tuple[_Cubes, Ints]:
    """Return the cubes of an image's labels, and the place in it of the voxel from whose middle they are measured."""
    assert spec.size is not None
    path, size, labels = image.path, spec.size, image.names
    voxels, first = _cropped(image)
    if (expected := sum(volumes) / (_CELLS * size**3)) > spec.maximum_cells:
        raise MeshError(
            f"{path}: about {expected:,.0f} cells of {readable(size, 'm')} are expected, more than"
            f" {spec.maximum_cells:,}",
            "Make mesh.size larger, or mesh.maximum_cells.",
        )
    sizes = wall_sizes(voxels, image.spacing, len(labels), size, spec.grade)
    voxel = float(image.spacing.min())
    finest = _FINEST * voxel
    affordable, smooth = ((6 * sum(volumes) / count) ** (1 / 3) for count in (_MOST_LATTICE, _LEAST_LATTICE))
    resolved = min(max(_FINE * size, finest), max(_FINE * sizes.thinnest / fineness, finest, affordable))
    memberships = Memberships(voxels, len(labels), image.spacing, 0.5 * resolved)
    spacing = min(resolved, max(smooth, voxel))
    axes, begin = _middles(voxels.shape, image.spacing, spacing)
    cube_labels = np.stack([memberships.likeliest(x, *axes[1:]) for x in axes[0]])
    if lost := [name for i, name in enumerate(labels, start=1) if not (cube_labels == i).any()]:
        raise MeshError(
            f"{path}: the label '{lost[0]}' is too small or thin for cells of {readable(size, 'm')}",
            "Use smaller ones.",
        )
    volumes = represented_volumes(
        image, cube_labels, (begin + 0.5 * spacing) / image.spacing + first, spacing, volumes, report
    )
    cube_labels, begin = np.pad(cube_labels, 1), begin - spacing  # with room for cells around the body
    tolerance *= float(image.spacing.min())
    return _Cubes(path, cube_labels, begin, spacing, memberships, sizes, volumes, tolerance), first


def _cells(cubes: _Cubes, report: Callable[[str], None]) -> tuple[Lattice, Floats, Floats, float]:
    """Make cells of cubes.

    Returns:
        The cells; their points (n, 3) on smooth boundaries; the middles of facets that cross others, if that could not
        be avoided; and the scaled Jacobian below which no cell became worse.
    """
    outer_cells = np.zeros(cubes.labels.shape, dtype=bool)
    filled, why = cells_between_surfaces(cubes.labels, cubes.begin, cubes.spacing, cubes.memberships, cubes.sizes)
    if why:
        report(f"{why}: meshed from a lattice, which takes longer")
    for reach in (*_REACHES, 0):
        lattice = filled
        if lattice is None:
            lattice = lattice_of(cubes.labels, cubes.spacing, (cubes.labels > 0) | outer_cells)
            lattice = replace(lattice, points=lattice.points + cubes.begin)
        for least in (GOOD, ROUGH):  # volumes are worth more than shapes of a few cells
            passes = 1 if lattice is filled else _PASSES
            fitted, points = drop_outside(*_fitted(lattice, cubes, least, passes))
            error = max(map(abs, _volume_errors(points, fitted, cubes.volumes)))
            if error < 0.5 * _RIGHT:
                break
        crossing = _crossing(points, *interfaces(fitted.cells, fitted.labels))
        if filled is not None and (len(crossing) or error >= _RIGHT):
            filled = None
            why = "cross" if len(crossing) else "lose volume"
            report(f"smooth surfaces {why}: meshed from a lattice, which takes longer")
            if not len(crossing):
                continue
        if not len(crossing) or not reach:
            break
        outer_cells |= _cells_outside(cubes.labels, ((crossing - cubes.begin) / cubes.spacing).astype(int), reach)
    return fitted, points, crossing, least


def _fitted(lattice: Lattice, cubes: _Cubes, least: float, passes: int) -> tuple[Lattice, Floats]:
    """Cells of a good shape and size, and their nodes on smooth boundaries, where no cell is worse than ``least``."""
    points = smoothed(lattice, cubes.memberships, cubes.spacing, cubes.volumes, ROUGH)
    for _ in range(passes):  # in cells of good shape, nodes that were held back come nearer to the boundary
        lattice = _remeshed(replace(lattice, points=points), cubes)
        points = smoothed(lattice, cubes.memberships, cubes.spacing, cubes.volumes, least)
    return lattice, points


def _crossing(points: Floats, facets: Ints, pairs: Ints) -> Floats:
    """Middles (n, 3) of facets of the body's surface that cross others."""
    tags = facets[pairs[:, 0] == 0]
    surface = Surface("triangle", 1, tags, points[tags], np.ones(len(tags), dtype=bool))
    return np.asarray(surface.nodes[list(find_overlap(surface).facets)].mean(axis=1))


def _cells_outside(labels: Ints, places: Ints, reach: int) -> Booleans:
    """Cells (as in ``labels``) next to the body in narrow gaps, and up to ``reach`` cells from ``places`` (n, 3).

    There, they keep apart surfaces that face each other, and the surface from folding over: a cell between would be
    turned inside out.
    """
    body, cube = labels > 0, np.ones((3, 3, 3))
    shell = ndimage.binary_dilation(body, cube)
    gaps = ndimage.binary_closing(np.pad(body, 3), cube, iterations=_GAPS)[3:-3, 3:-3, 3:-3]
    for place in places:
        gaps[tuple(slice(max(i - reach, 0), i + reach + 1) for i in place)] = True
    return np.asarray(gaps & shell & ~body)


def _box(image: LabelImage) -> tuple[Ints, Ints]:
    """First voxels of the labels along each axis, and those after the last."""
    (box,) = ndimage.find_objects((image.voxels > 0).astype(np.int8))
    return np.array([side.start for side in box]), np.array([side.stop for side in box])


def _cropped(image: LabelImage) -> tuple[Ints, Ints]:
    """Voxels of the labels with a margin of three of the outside, and the place of the first of them in the image."""
    margin = 3
    low, high = _box(image)
    box_voxels = image.voxels[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    return np.pad(box_voxels, margin), low - margin


def _middles(shape: tuple[int, ...], voxel: Floats, spacing: float) -> tuple[list[Floats], Floats]:
    """Coordinates of the middles of the lattice's cells (m from the image's first voxel), and where it begins."""
    extent = (np.array(shape) - 1) * voxel
    counts = np.maximum(np.floor(extent / spacing).astype(int), 1)
    begin = (extent - counts * spacing) / 2
    return [b + (np.arange(n) + 0.5) * spacing for b, n in zip(begin, counts, strict=True)], begin


def _remeshed(lattice: Lattice, cubes: _Cubes) -> Lattice:
    """Improve and coarsen cells by MMG; boundaries stay within the tolerance."""
    mmgpy = package("mmgpy", MMG)
    sizes = cubes.sizes
    scale = 1 / sizes.size  # MMG's tolerances are made for lengths of about 1
    mesh = mmgpy.MmgMesh3D()
    mesh.set_mesh_size(vertices=len(lattice.points), tetrahedra=len(lattice.cells))
    mesh.set_vertices(lattice.points * scale)
    mesh.set_tetrahedra(lattice.cells.astype(np.int32), refs=lattice.labels + 1)  # 0 is none to MMG
    if sizes.is_graded:
        mesh.set_field("metric", sizes.interpolate(lattice.points)[:, None] * scale)
    least = min(sizes.least * scale, _UNIFORM)
    options: dict[str, Any] = {"hmax": 1.0, "hmin": least, "hausd": cubes.tolerance * scale, "hgrad": 1.5}
    try:
        with handlers_restored():  # MMG removes the handlers of SIGTERM and SIGINT
            mesh.remesh(**options, ar=60.0, verbose=-1)
    except RuntimeError as error:
        raise MeshError(f"{cubes.path}: MMG could not mesh it: {error}", "Try another mesh.size.") from error
    tetrahedra, references = mesh.get_tetrahedra_with_refs()[:2]
    cells, labels = np.asarray(tetrahedra, dtype=np.int64), np.asarray(references, dtype=np.int64) - 1
    return Lattice(np.asarray(mesh.get_vertices()) / scale, cells, labels)


def _volume_errors(points: Floats, cells: Lattice, volumes: Sequence[float]) -> list[float]:
    """Relative errors of the volumes of the labels' cells with their nodes at some points."""
    cell_volumes = np.bincount(cells.labels, cells.volumes(points), minlength=len(volumes) + 1)[1:]
    return [float(cell_volume / volume - 1) for cell_volume, volume in zip(cell_volumes, volumes, strict=True)]


def _tell_volumes(
    image: LabelImage, volumes: Sequence[float], errors: Sequence[float], report: Callable[[str], None]
) -> None:
    """Report the volumes of the regions; ``MeshError`` where cells are too large for them."""
    for name, volume, error in zip(image.names, volumes, errors, strict=True):
        if abs(error) > _WRONG:
            raise MeshError(
                f"{image.path}: walls are too thin for these cells: '{name}' has {error:+.1%} of its volume,"
                f" {readable(volume, 'm^3')}",
                "Make mesh.size smaller; walls of less than two voxels need a finer image.",
            )
        note = " (walls are thin for these cells)" if abs(error) > _RIGHT else ""
        report(f"{name}: {readable(volume, 'm^3')}, {error:+.2%} in the mesh{note}")


def _is_at_border(points: Floats, facets: Ints, first: Ints, image: LabelImage) -> Booleans:
    """Return whether facets lie where the image ends: within a voxel of its last middles, and along it."""
    corners = points[facets]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-300
    middles = corners.mean(axis=1) / image.spacing + first  # in voxels
    last = np.array(image.voxels.shape) - 1
    is_border = np.zeros((len(facets), 3), dtype=bool)
    low, high = _box(image)
    for is_cut, depth in ((low == 0, middles), (high == last + 1, last - middles)):
        is_border |= is_cut & ((depth < -0.2) | ((depth < 1) & (np.abs(normals) > 0.5)))
    return np.asarray(is_border.any(axis=1))


def _groups(
    names: Sequence[str], labels: Ints, pairs: Ints, is_cut: Booleans, neighbours: NameArray
) -> tuple[Group, ...]:
    """Regions of cells and facets."""
    groups = [Group(name, 3, i, np.flatnonzero(labels == i)) for i, name in enumerate(names, start=1)]
    tag = len(names)
    for low, high in np.unique(pairs, axis=0):
        is_between = (pairs == (low, high)).all(axis=1) & ~is_cut
        for other in [names[low - 1]] if low else sorted(set(neighbours[is_between]), key=lambda name: name != OUTSIDE):
            members = np.flatnonzero(is_between if low else is_between & (neighbours == other))
            tag += 1
            name = f"{names[high - 1]}|{other}" if low == 0 else f"{other}|{names[high - 1]}"
            groups += [Group(name, 2, tag, members)] if len(members) else []
    cut = np.flatnonzero(is_cut)
    return (*groups, *([Group(CUT, 2, tag + 1, cut)] if len(cut) else []))


@dataclass(frozen=True)
class GivenSurface:
    """The triangles from which a body was filled with voxels.

    Attributes:
        surface: all triangles, in m from the first voxel's middle.
        memberships: of the voxels, which determine on which side a label is.
    """

    surface: pyvista.PolyData
    memberships: Memberships

    def nearest(self, points: Floats, lower: Ints, upper: Ints, reach: float) -> tuple[Floats, Floats]:
        """Points (n, 3) of the surface nearest to the given ones, at most ``reach`` (m) away, and normals (n, 3) from
        label ``upper`` into ``lower``."""
        _, normals = self.memberships.nearest(points, lower, upper, reach)
        _, closest = self.surface.find_closest_cell(points, return_closest_point=True)
        return limit_steps(points, np.reshape(closest, (-1, 3)), reach), normals
