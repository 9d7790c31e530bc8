"""Flat ends of the surface of a lumen: openings and flat caps that it has, and planes by which it is cut."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyvista

from hpcinv.base.quantity.units import readable
from hpcinv.errors import MeshError
from hpcinv.mesh.smooth_faces import smooth_faces
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.topology import connected, unique_rows

_FLAT = 0.03
"""distance of a rim from its plane, relative to its radius; raised, walls around warped rims are squeezed"""
_SAME_PLANE = np.deg2rad(2.0)  # between neighbours of one cap; raised, caps of coarse round ends are taken for flat
_EDGE = np.deg2rad(50.0)  # between a cap and what is next to it; raised, oblique caps are not seen
_ON_PLANE = 1e-7  # relative to the body: distance of nodes of a section from their plane
_AWAY = 2.0  # distance of an end from the point that names it, relative to its radius, up to which it is meant


@dataclass(frozen=True)
class Rim:
    """A closed curve of edges around an opening of a surface.

    Attributes:
        nodes: numbers of its nodes, in no order.
        middle: mean of the positions of the nodes.
        normal: unit normal of the plane of the rim, which points out of the vessel.
        radius: mean distance of the nodes from the middle.
        off: largest distance of a node from the plane.
    """

    nodes: Ints
    middle: Floats
    normal: Floats
    radius: float
    off: float


def place_of(point: Floats) -> str:
    """Return a point (m) for a message."""
    return "({}) m".format(", ".join(f"{round(x, 6):.4g}" for x in point.tolist()))


def open_edges(triangles: Ints) -> Ints:
    """Return the edges (n, 2) of one triangle only."""
    edges, place = unique_rows(
        np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]))
    )
    return np.asarray(edges[np.bincount(place, minlength=len(edges)) == 1])


def rims_of(surface: pyvista.PolyData, path: Path) -> list[Rim]:
    """Return the rims of the openings of a surface in m, the largest first.

    Raises:
        MeshError: edges of openings meet.
    """
    points, triangles = np.asarray(surface.points, dtype=np.float64), surface.regular_faces.astype(np.int64)
    edges = open_edges(triangles)
    if not len(edges):
        return []
    nodes, compact = np.unique(edges, return_inverse=True)
    compact = compact.reshape(-1, 2)
    if (np.bincount(compact.ravel()) != 2).any():
        crossing = nodes[np.bincount(compact.ravel()) != 2][0]
        text = f"edges of openings of the lumen meet at {place_of(points[crossing])}"
        raise MeshError(f"{path}: {text}", "Repair the surface (Blender, MeshLab).")
    piece = connected(compact, len(nodes))
    of_node = np.zeros(len(nodes), dtype=np.int64)
    of_node[compact] = piece[:, None]
    touching = np.isin(triangles, nodes).any(axis=1)
    rims = []
    for number in range(piece.max() + 1):
        members = nodes[of_node == number]
        ends = points[edges[piece == number]]
        lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        middle = np.average(ends.mean(axis=1), axis=0, weights=lengths)
        arms = points[members] - middle
        normal = np.linalg.svd(arms, full_matrices=False)[2][2]
        next_cells = triangles[touching][np.isin(triangles[touching], members).any(axis=1)]
        if ((points[next_cells].mean(axis=1) - middle) @ normal).mean() > 0:
            normal = -normal
        radius = float(np.linalg.norm(arms, axis=1).mean())
        off = float(np.abs(arms @ normal).max())
        rims.append(Rim(members, middle, normal, radius, off))
    return sorted(rims, key=lambda rim: -rim.radius)


def check_flat(rims: Sequence[Rim], path: Path) -> None:
    """Raise ``MeshError`` if the nodes of a rim are not in a plane."""
    for rim in rims:
        if rim.off > _FLAT * rim.radius:
            where, distance = place_of(rim.middle), readable(rim.off, "m")
            raise MeshError(
                f"{path}: the end of the lumen near {where} is not flat: it is up to {distance} from a plane",
                "Cut it by a plane: 'mesh: {ends: {NAME: {at: [x, y, z], normal: [nx, ny, nz]}}}'.",
            )


def without_caps(surface: pyvista.PolyData) -> pyvista.PolyData:
    """Return a closed surface without its flat caps: flat parts that end at sharp edges all around."""
    points, triangles = np.asarray(surface.points, dtype=np.float64), surface.regular_faces.astype(np.int64)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    areas = np.cross(b - a, c - a) / 2
    flat = smooth_faces(triangles, areas, _SAME_PLANE)
    sharp = smooth_faces(triangles, areas, _EDGE)
    caps = np.zeros(len(triangles), dtype=bool)
    for number in np.unique(sharp):
        face = sharp == number
        if len(np.unique(flat[face])) == 1:  # flat as a whole, and round parts are not
            caps |= face
    if caps.all() or not caps.any():
        return surface
    return pyvista.PolyData.from_regular_faces(points, triangles[~caps]).clean()


def cut_at(surface: pyvista.PolyData, point: Floats, normal: Floats, name: str, path: Path) -> pyvista.PolyData:
    """Return a surface without the part beyond a plane that begins at its section around a point.

    Raises:
        MeshError: the plane does not cut it.
    """
    near = _ON_PLANE * surface.length
    kept, beyond = (
        merged(surface.clip(normal=tuple(normal), origin=tuple(point), invert=invert), near) for invert in (True, False)
    )
    candidates: list[tuple[float, Ints, Ints]] = []
    if kept.n_cells and beyond.n_cells:
        points, triangles = np.asarray(beyond.points, dtype=np.float64), beyond.regular_faces.astype(np.int64)
        piece = connected(triangles, len(points))
        for number in range(piece.max() + 1):
            cells = triangles[piece == number]
            rim = points[np.unique(cells)]
            rim = rim[np.abs((rim - point) @ normal) < near]
            if len(rim):
                candidates.append((float(np.linalg.norm(rim.mean(axis=0) - point)), piece == number, rim))
    if not candidates:
        text = f"the plane of the end '{name}' at {place_of(point)} does not cut the lumen"
        raise MeshError(f"{path}: {text}", "Give a point in the lumen in the frame of the file, in its unit.")
    distance, removed, rim = min(candidates, key=lambda candidate: candidate[0])
    if distance > _AWAY * float(np.linalg.norm(rim - rim.mean(axis=0), axis=1).mean()):
        text = (
            f"the plane of the end '{name}' cuts the lumen at {place_of(rim.mean(axis=0))}, away from the point given"
        )
        raise MeshError(f"{path}: {text}", "Give a point near the middle of the section.")
    rest = pyvista.PolyData.from_regular_faces(points, triangles[~removed]) if not removed.all() else None
    return merged(pyvista.merge([kept, rest]), near) if rest is not None else kept


def merged(surface: pyvista.PolyData, near: float) -> pyvista.PolyData:
    """Return triangles without those that have no area when points at a distance become one."""
    surface = surface.triangulate().clean(tolerance=near, absolute=True)
    return pyvista.PolyData(surface.points, faces=surface.faces)


def largest_part(surface: pyvista.PolyData) -> tuple[pyvista.PolyData, float]:
    """Return the largest connected part of a surface, and the share of the area that it has."""
    triangles = surface.regular_faces.astype(np.int64)
    points = np.asarray(surface.points, dtype=np.float64)
    piece = connected(triangles, len(points))
    if not piece.max():
        return surface, 1.0
    a, b, c = (points[triangles[:, i]] for i in range(3))
    areas = np.bincount(piece, np.linalg.norm(np.cross(b - a, c - a), axis=1))
    kept = triangles[piece == areas.argmax()]
    return pyvista.PolyData.from_regular_faces(points, kept).clean(), float(areas.max() / areas.sum())


def names_of(rims: Sequence[Rim], places: dict[str, Floats], path: Path) -> list[str]:
    """Return the names of rims: given by points near them, or ``end-1``, ``end-2`` and so on.

    Raises:
        MeshError: there is no end near a point, or two points are nearest to the same end.
    """
    names = [""] * len(rims)
    for name, point in places.items():
        far = [float(np.linalg.norm(rim.middle - point)) for rim in rims]
        nearest = int(np.argmin(far))
        where = "; ".join(place_of(rim.middle) for rim in rims)
        if far[nearest] > _AWAY * rims[nearest].radius:
            text = f"the lumen has no flat end near the point of '{name}'; its ends are at {where}"
            raise MeshError(f"{path}: {text}", "Give one of them, or a 'normal' to cut the lumen at the point.")
        if names[nearest]:
            text = f"'{name}' and '{names[nearest]}' are the same end, at {place_of(rims[nearest].middle)}"
            raise MeshError(f"{path}: {text}", f"The ends of the lumen are at {where}.")
        names[nearest] = name
    rest = iter(f"end-{number}" for number in range(1, len(rims) + 1))
    return [name or next(rest) for name in names]
