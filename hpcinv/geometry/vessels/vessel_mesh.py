"""Mesh of the wall around the lumen of a vessel: layers of tetrahedra from its surface outwards, with flat ends."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyvista

from hpcinv.base.parallel.signals import handlers_restored
from hpcinv.base.quantity.units import readable
from hpcinv.errors import MeshError
from hpcinv.geometry.imaging.curved_cells import edge_nodes, shares_of_bend
from hpcinv.geometry.imaging.image_files import package
from hpcinv.geometry.imaging.mesh_report import report_mesh
from hpcinv.geometry.vessels.flat_ends import (
    Rim,
    check_flat,
    cut_at,
    largest_part,
    names_of,
    open_edges,
    place_of,
    rims_of,
)
from hpcinv.geometry.vessels.lumen import read_lumen
from hpcinv.geometry.vessels.wall_layers import (
    Base,
    Distance,
    NoWall,
    layer_points,
    lengths_along,
    march,
    outer_points,
    side_facets,
    tetrahedra,
)
from hpcinv.job.lumen import INNER, OUTER, WALL
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh.cell_count import require_at_most
from hpcinv.mesh.cells import mirrored
from hpcinv.mesh.checks import det
from hpcinv.mesh.crossing_facets import find_overlap
from hpcinv.mesh.refine.degree import raised
from hpcinv.mesh.source import Floats, Group, Ints, MeshSource
from hpcinv.mesh.surface import Surface
from hpcinv.mesh.topology import find_rows

_MMG = "vessels are meshed by MMG (mmgpy)"
_WITHIN = (0.05, 0.1)
"""distance of triangles from the lumen, relative to their size and to the radius of the narrowest end: the smaller one;
lower values make more triangles around narrow branches"""
_SHORTEST = 0.4  # edge, relative to the smaller of the same: shorter ones where branches part make walls fold
_PER_AREA = 2.3  # triangles in the square of their edge
_IN_PRISM = 3  # tetrahedra
_NOTED = 0.02  # part of a lumen's area that may be left out without a line


@dataclass(frozen=True)
class _Vessel:
    """Triangles of a lumen, and its ends.

    Attributes:
        smooth: the given surface; nodes lie on it.
        edges: of the rim of each end, by its name.
        rims: planes of the ends, by name.
    """

    base: Base
    smooth: pyvista.PolyData
    edges: dict[str, Ints]
    rims: dict[str, Rim]


def vessel_mesh(path: Path, spec: MeshSpec, report: Callable[[str], None]) -> MeshSource:
    """Mesh the wall around a lumen on this process, in metres.

    Regions are `WALL` (cells), `INNER` and `OUTER` (facets), and the ends by name.

    Raises:
        MeshError: the lumen cannot be read, has no flat end, or the wall is too thick for it.
        SystemPartMissing: the packages for images are not installed.
    """
    assert spec.wall is not None
    vessel, frame = _vessel(path, spec, report)
    base, first = vessel.base, next(iter(vessel.rims))
    far = lengths_along(base, vessel.rims[first].nodes)
    thickness = np.interp(far, spec.wall.distance, spec.wall.thickness)
    if len(spec.wall.distance) > 1:
        report(f"the thickness follows the distance from '{first}', up to {readable(float(far.max()), 'm')}")
    try:
        outer = outer_points(base, Distance(vessel.smooth), thickness, spec.layers)
    except NoWall as error:
        raise _too_thick(path, "is thicker than the radius of curvature of the lumen", error.point, thickness) from None
    _check_crossing(path, base.triangles, outer, thickness)
    mesh = _layered(path, vessel, outer, spec.layers)
    if spec.geometry_degree == 2:
        mesh = _curved(mesh, vessel, thickness, spec.layers, report)
    report_mesh(mesh, frame, report)
    for name, rim in vessel.rims.items():
        middle = place_of(rim.middle)
        report(f"end '{name}' at {middle}, mean radius of the lumen {readable(rim.radius, 'm')}")
    return mesh


def _too_thick(path: Path, what: str, point: Floats, thickness: Floats) -> MeshError:
    text = f"{path}: a wall of {readable(float(thickness.max()), 'm')} {what} near {place_of(point)}"
    return MeshError(text, "Make mesh.wall thinner, smooth the lumen there, or make mesh.size larger.")


def _vessel(path: Path, spec: MeshSpec, report: Callable[[str], None]) -> tuple[_Vessel, str]:
    """Return the lumen in triangles of the wanted size, with its ends, and the frame of positions."""
    assert spec.size is not None
    lumen = read_lumen(path, spec)
    surface = lumen.surface
    for name, end in spec.ends.items():
        if end.normal is not None:
            normal = np.array(end.normal) / np.linalg.norm(end.normal)
            surface = cut_at(surface, np.array(end.at), normal, name, path)
    for number, (point, normal) in enumerate(lumen.cuts, 1):
        if _has_section(surface, point, normal):
            surface = cut_at(surface, point, normal, f"end-{number}", path)
    surface, share = largest_part(surface)
    if 1 - share > _NOTED:
        report(f"warning: parts of the lumen apart from the largest one are left out, {1 - share:.0%} of its surface")
    rims = rims_of(surface, path)
    if not rims:
        raise MeshError(
            f"{path}: the lumen has no flat end",
            "Cut it by planes: 'mesh: {ends: {NAME: {at: [x, y, z], normal: [nx, ny, nz]}}}'.",
        )
    check_flat(rims, path)
    names = names_of(rims, {name: np.array(end.at) for name, end in spec.ends.items()}, path)
    order = sorted(range(len(rims)), key=lambda i: [*spec.ends, names[i]].index(names[i]))
    require_at_most(path, _PER_AREA * _IN_PRISM * spec.layers * surface.area / spec.size**2, spec.maximum_cells)
    points, triangles = _remeshed(path, surface, spec.size, min(rim.radius for rim in rims))
    _check_crossing(path, triangles, points, None)
    return _with_ends(path, surface, points, triangles, {names[i]: rims[i] for i in order}), lumen.frame


def _has_section(surface: pyvista.PolyData, point: Floats, normal: Floats) -> bool:
    """Return whether a surface still has something beyond a plane, near its point, that other cuts left."""
    nearest = surface.find_closest_point(point)
    height = (np.asarray(surface.points, dtype=np.float64) - point) @ normal
    reach = 2 * float(np.linalg.norm(surface.points[nearest] - point))
    near = np.linalg.norm(np.asarray(surface.points) - point, axis=1) < 2 * reach
    return bool((height[near] > 0).any() and (height[near] < 0).any())


def _remeshed(path: Path, surface: pyvista.PolyData, size: float, narrowest: float) -> tuple[Floats, Ints]:
    """Return points and triangles of good shape on a surface."""
    mmgpy = package("mmgpy", _MMG)
    scale = 1 / size  # MMG's tolerances are made for lengths of about 1
    mesh = mmgpy.MmgMeshS()
    mesh.set_mesh_size(vertices=surface.n_points, triangles=surface.n_cells)
    mesh.set_vertices(np.asarray(surface.points, dtype=np.float64) * scale)
    mesh.set_triangles(surface.regular_faces.astype(np.int32))
    finest = min(1.0, narrowest * scale)
    within = min(_WITHIN[0], _WITHIN[1] * narrowest * scale)
    try:
        with handlers_restored():  # MMG removes the handlers of SIGTERM and SIGINT
            mesh.remesh(hmax=1.0, hmin=_SHORTEST * finest, hausd=within, hgrad=1.5, ar=60.0, verbose=-1)
    except RuntimeError as error:
        raise MeshError(f"{path}: MMG could not mesh the lumen: {error}", "Try another mesh.size.") from error
    points, triangles = np.asarray(mesh.get_vertices()) / scale, np.asarray(mesh.get_triangles(), dtype=np.int64)
    used, compact = np.unique(triangles, return_inverse=True)
    return points[used], compact.reshape(-1, 3)


def _check_crossing(path: Path, triangles: Ints, points: Floats, thickness: Floats | None) -> None:
    tags = triangles
    surface = Surface("triangle", 1, tags, points[tags], np.ones(len(tags), dtype=bool))
    overlap = find_overlap(surface)
    if overlap.point is None:
        return
    where = np.array(overlap.point)
    if thickness is None:
        text = f"{path}: the surface of the lumen cuts itself near {place_of(where)}"
        raise MeshError(text, "Repair it (Blender, MeshLab), or make mesh.size smaller.")
    raise _too_thick(path, "meets itself", where, thickness)


def _with_ends(path: Path, smooth: pyvista.PolyData, points: Floats, triangles: Ints, rims: dict[str, Rim]) -> _Vessel:
    """Return triangles with the nodes of their rims exactly in the planes of the ends."""
    surface = pyvista.PolyData.from_regular_faces(points, triangles)
    edges, in_plane = open_edges(triangles), np.zeros_like(points)
    own_edges, own_rims = dict[str, Ints](), dict[str, Rim]()
    for new in rims_of(surface, path):
        name = min(rims, key=lambda known: float(np.linalg.norm(rims[known].middle - new.middle)))
        plane = rims[name]
        points[new.nodes] -= ((points[new.nodes] - plane.middle) @ plane.normal)[:, None] * plane.normal
        in_plane[new.nodes] = plane.normal
        own_edges[name] = edges[np.isin(edges[:, 0], new.nodes)]
        own_rims[name] = replace(plane, nodes=new.nodes)
    if own_rims.keys() != rims.keys():
        raise MeshError(f"{path}: an end of the lumen is too narrow for mesh.size", "Make mesh.size smaller.")
    base = Base(points, triangles, in_plane)
    return _Vessel(base, smooth, {n: own_edges[n] for n in rims}, {n: own_rims[n] for n in rims})


def _layered(path: Path, vessel: _Vessel, outer: Floats, layers: int) -> MeshSource:
    """Return straight cells between the lumen and the outer points."""
    base = vessel.base
    count = len(base.points)
    points = layer_points(base.points, outer, layers)
    cells = tetrahedra(base.triangles, count, layers)
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    turned = det(edges) < 0
    cells[turned] = mirrored("tetrahedron", 1, cells[turned])
    surfaces = {INNER: base.triangles, OUTER: base.triangles + layers * count}
    surfaces |= {name: side_facets(edges, count, layers) for name, edges in vessel.edges.items()}
    facets = np.concatenate([*surfaces.values()])
    groups, begin = [Group(WALL, 3, 1, np.arange(len(cells)))], 0
    for tag, (name, members) in enumerate(surfaces.items(), start=2):
        groups.append(Group(name, 2, tag, np.arange(begin, begin + len(members))))
        begin += len(members)
    return MeshSource(
        path=path,
        kind="tetrahedron",
        degree=1,
        points=points,
        node_tags=np.arange(1, len(points) + 1),
        cells=cells,
        cell_tags=np.arange(1, len(cells) + 1),
        facets=facets,
        groups=tuple(groups),
    )


def _curved(
    mesh: MeshSource, vessel: _Vessel, thickness: Floats, layers: int, report: Callable[[str], None]
) -> MeshSource:
    """Return cells of second degree, whose nodes between others are on the lumen and at the thickness from it."""
    base = vessel.base
    count = len(base.points)
    curved = raised(mesh)
    nodes, first, second = edge_nodes(curved).T
    pairs = np.sort(np.column_stack([first % count, second % count]), axis=1)
    between = pairs[:, 0] != pairs[:, 1]
    sides, place = np.unique(pairs[between], axis=0, return_inverse=True)
    place = place.ravel()
    middles = base.points[sides].mean(axis=1)
    _, on_lumen = vessel.smooth.find_closest_cell(middles, return_closest_point=True)
    inner = np.reshape(on_lumen, (-1, 3)).astype(np.float64)
    planes = np.zeros((len(sides), 3))
    for name, rim in vessel.rims.items():
        rows = find_rows(np.sort(vessel.edges[name], axis=1), sides)
        planes[rows] = rim.normal
    inner -= np.einsum("ij,ij->i", inner - middles, planes)[:, None] * planes
    last = layers * count
    directions = (mesh.points[sides + last] - base.points[sides]).mean(axis=1)
    directions -= np.einsum("ij,ij->i", directions, planes)[:, None] * planes
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    outer = march(inner, directions, thickness[sides].mean(axis=1), Distance(vessel.smooth))
    share = ((first // count + second // count) / (2 * layers))[between][:, None]
    target = inner[place] + share * (outer - inner)[place]
    bend = np.zeros_like(curved.points)
    bend[nodes[between]] = target - curved.points[nodes[between]]
    shares = shares_of_bend(curved.cells, curved.points, bend, np.ones(len(bend)))
    moved = np.linalg.norm(shares[:, None] * bend, axis=1)
    held = np.count_nonzero((shares < 1) & bend.any(axis=1))
    report(
        f"cells of second degree: nodes up to {readable(float(moved.max()), 'm')} from straight edges; {held:,} held"
        " back for the shape of cells"
    )
    return replace(curved, points=curved.points + shares[:, None] * bend)
