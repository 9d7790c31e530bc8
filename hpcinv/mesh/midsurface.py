"""The body of a shell: one layer of hexahedra of degree 2 around a surface of quadrilaterals.

A node of the surface has a column of three nodes, at the inner face, on the surface and at the outer face. A map of the
body is quadratic in the distance ``ζ`` from the surface: ``y = y₀ + ζ y₁ + ζ² y₂``, with the director ``y₁`` and the
quadratic part ``y₂``, without which a law of three dimensions would be too stiff in bending. The values of the three
columns' nodes determine ``y₀``, ``y₁`` and ``y₂``: a displacement of degree 2 is the displacement of a shell with
director, with the strains of its solid, and `LayerDegree` is the quadrature by which it does not lock.

Source: Chapelle, Ferent & Bathe, Math. Models Methods Appl. Sci. 14, 105–142, 2004 (elements of this kind).
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import NoReturn

import numpy as np

from hpcinv.errors import MeshError
from hpcinv.formats.mesh_format import INNER, OUTER
from hpcinv.job.sections import Shell
from hpcinv.mesh.cells import scalar_element, sub_entities, vertex_count
from hpcinv.mesh.source import DataArray, Floats, Group, Ints, MeshSource, distinct_tags
from hpcinv.mesh.topology import unique_rows, vertex_sets

_KIND, _DEGREE = "quadrilateral", 2
_SHARPEST = 40.0
"""degrees between normals of cells at a common node; raised, a fold becomes a shell of changing thickness"""

_THINNEST = 3e3
"""length of a surface by its thickness; raised, rounding errors of displacements strain the layer as much as its load,
and Newton's method does not converge"""


def thicken(surface: MeshSource, shell: Shell) -> MeshSource:
    """Return the body of a shell, whose nodes are the surface's, then the inner face's and the outer face's.

    The outer face is where the normals of the cells point to: outwards if the surface is closed, else on the side of
    the first cell's normal, by the order of its nodes. A group of cells ``NAME`` has further groups ``NAME|outer`` and
    ``NAME|inner`` of its faces, and a group of edges becomes one of facets through the thickness.

    Raises:
        MeshError: the surface has folds or junctions, or only one side; or it lacks the data of its faces.
    """
    if shell.thickness is None:
        inner, outer = (_vectors(surface, name) for name in (INNER, OUTER))
        thickness = float(np.linalg.norm(outer - inner, axis=1).mean())
    else:
        thickness = shell.thickness
    extent = float(np.linalg.norm(np.ptp(surface.points, axis=0)))
    if extent > _THINNEST * thickness:
        text = f"is {extent / thickness:,.0f} times as long as the shell is thick (at most {_THINNEST:,.0f})"
        _refuse(
            surface.path, text, "Are 'thickness' and mesh.unit right? In thinner shells rounding errors are too large."
        )
    if taken := [group.name for group in surface.groups if group.name in (OUTER, INNER)]:
        text = f"has a physical group '{taken[0]}', which is the name of a face of the shell"
        _refuse(surface.path, text, "Give the group another name.")
    surface = dataclasses.replace(surface, cells=_oriented(surface))
    normals, count = _normals(surface), len(surface.points)
    if shell.thickness is not None:
        outer = thickness / 2 * normals
        inner = -outer
    elif ((outer - inner) * normals).sum() < 0:  # by the order of their nodes, cells have the other normal
        surface = dataclasses.replace(surface, cells=_mirrored(surface.cells))
    cells = _columns(_KIND, "hexahedron", surface.cells, count)
    edges = _columns("interval", _KIND, surface.facets, count)
    sheet = surface.cells[:, _order(_KIND, _KIND)]
    facets = np.concatenate([edges, sheet + count, sheet + 2 * count])
    groups = list(surface.groups)
    every = np.arange(len(sheet))
    for name, first in ((INNER, len(edges)), (OUTER, len(edges) + len(sheet))):
        groups.append(Group(name, 2, 0, first + every))
        parts = [group for group in surface.groups if group.dim == 3]
        groups.extend(Group(f"{group.name}|{name}", 2, 0, first + group.members) for group in parts)
    return dataclasses.replace(
        surface,
        kind="hexahedron",
        points=np.concatenate([surface.points, surface.points + inner, surface.points + outer]),
        node_tags=np.concatenate([surface.node_tags, surface.node_tags.max() + 1 + np.arange(2 * count)]),
        cells=cells,
        facets=facets,
        groups=distinct_tags(groups),
        data=surface.nodal_data(lambda values: np.tile(values, (3, 1))),
        midsurface=surface,
        slenderness=_slenderness(surface, thickness),
    )


def _slenderness(surface: MeshSource, thickness: float) -> float:
    """Return the mean diameter of the cells by their thickness; 1 without cells."""
    corners = surface.points[surface.cells[:, :4]]
    diameters = np.linalg.norm(corners[:, 3] - corners[:, 0], axis=1)
    return float(diameters.mean() / thickness) if len(diameters) else 1.0


def surface_source(body: MeshSource, points: Floats) -> tuple[MeshSource, Floats]:
    """Return the surface of a shell with data of its body, and its nodes, for the nodes (n, 3) of the body.

    Data arrays ``outer`` and ``inner`` are the vectors from a node of the surface to the faces (m), ``director`` is the
    unit vector between the faces, and ``thickness`` their distance (m).
    """
    surface = body.midsurface
    assert surface is not None
    count = len(surface.points)
    middle, inner, outer = points[:count], points[count : 2 * count], points[2 * count :]
    through = outer - inner
    thickness = np.linalg.norm(through, axis=1, keepdims=True)
    arrays = {
        OUTER: outer - middle,
        INNER: inner - middle,
        "thickness": thickness,
        "director": through / np.maximum(thickness, 1e-300),
    }
    data = {
        name: dataclasses.replace(array, values=array.values[:count]) if array.place == "nodes" else array
        for name, array in body.data.items()
    }
    more = {name: DataArray(name, "nodes", values) for name, values in arrays.items()}
    return dataclasses.replace(surface, data=data | more), middle


def _vectors(surface: MeshSource, name: str) -> Floats:
    """Vectors (n, 3) of a data array; raises ``MeshError`` if there is none."""
    array = surface.data.get(name)
    if array is None or array.place != "nodes" or array.values.shape[1] != 3 or not np.isfinite(array.values).all():
        known = ", ".join(sorted(surface.data)) or "none"
        text = f"has no array '{name}' of vectors at all nodes (arrays: {known})"
        _refuse(surface.path, text, "Give 'thickness' instead of 'director: data', or a shape file of a run.")
    return array.values


def _order(kind: str, flat: str) -> Ints:
    """Local node of ``flat`` cells above which each node of ``kind`` cells lies, which have one axis more or none."""
    columns, places = (scalar_element(k, _DEGREE).points for k in (kind, flat))
    dim = places.shape[1]
    distances = np.abs(columns[:, None, :dim] - places[None]).max(axis=2)
    return np.asarray(distances.argmin(axis=1), dtype=np.int64)


def _columns(flat: str, kind: str, nodes: Ints, count: int) -> Ints:
    """Cells of one dimension more, whose last axis goes through the thickness."""
    height = np.rint(2 * scalar_element(kind, _DEGREE).points[:, -1]).astype(np.int64)
    layer = np.array([1, 0, 2])[height] * count  # inner face, surface, outer face
    return np.asarray(nodes[:, _order(kind, flat)] + layer)


def _oriented(surface: MeshSource) -> Ints:
    """Cells (c, 9) whose normals agree across edges, and point outwards if the surface is closed.

    Raises:
        MeshError: more than two cells share an edge, or the surface has only one side.
    """
    path, cells = surface.path, surface.cells
    local = sub_entities(_KIND, 1)
    # Basix numbers the vertices of a quadrilateral row by row: around it, its edges go so.
    around = np.array([1, -1, 1, -1])
    vertices, place = unique_rows(vertex_sets(cells[:, : vertex_count(_KIND)], local))
    ends = cells[:, local]
    direction = np.where(ends[:, :, 0] < ends[:, :, 1], 1, -1) * around
    sharing = np.bincount(place, minlength=len(vertices))
    if (sharing > 2).any():
        nodes = surface.node_tags[vertices[np.flatnonzero(sharing > 2)[0]]]
        raise MeshError(
            f"{path}: {(sharing > 2).sum()} edges belong to more than two cells (first: nodes {nodes[0]}, {nodes[1]})",
            "Junctions of shells are not possible: the director of a shell has one direction. Mesh a solid instead.",
        )
    pairs = np.argsort(place, kind="stable").reshape(-1)
    first_of = np.concatenate([[0], np.cumsum(sharing)[:-1]])[sharing == 2]
    a, b = pairs[first_of], pairs[first_of + 1]
    edges_per_cell = len(local)
    # Two cells agree if they go along their common edge in opposite directions.
    agree = np.where(direction.ravel()[a] * direction.ravel()[b] < 0, 1, -1)
    sign = _signs(a // edges_per_cell, b // edges_per_cell, agree, len(cells))
    if (sign[a // edges_per_cell] * agree != sign[b // edges_per_cell]).any():
        raise MeshError(f"{path}: the surface has only one side, as a Möbius strip", "Cut it, or mesh a solid.")
    if (sharing == 2).all():
        flat = surface.points[cells]
        areas = np.cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]) * sign[:, None]
        centre = surface.points.mean(axis=0)
        if ((flat[:, :4].mean(axis=1) - centre) * areas).sum() < 0:
            sign = -sign
    return np.where(sign[:, None] > 0, cells, _mirrored(cells))


def _mirrored(cells: Ints) -> Ints:
    """Cells whose two axes are exchanged, so that they have the opposite normal."""
    points = scalar_element(_KIND, _DEGREE).points
    return np.asarray(cells[:, np.abs(points[:, None, ::-1] - points[None]).max(axis=2).argmin(axis=1)])


def _signs(a: Ints, b: Ints, agree: Ints, count: int) -> Ints:
    """Sign of each cell, so that neighbours ``a`` and ``b`` agree; 1 for the first cell of each connected part."""
    neighbours: list[list[tuple[int, int]]] = [[] for _ in range(count)]
    for i, j, same in zip(a.tolist(), b.tolist(), agree.tolist(), strict=True):
        neighbours[i].append((j, same))
        neighbours[j].append((i, same))
    sign = [0] * count
    for start in range(count):
        if sign[start]:
            continue
        sign[start], waiting = 1, [start]
        while waiting:
            cell = waiting.pop()
            for other, same in neighbours[cell]:
                if not sign[other]:
                    sign[other] = sign[cell] * same
                    waiting.append(other)
    return np.array(sign, dtype=np.int64)


def _normals(surface: MeshSource) -> Floats:
    """Unit normals (n, 3) at the nodes: means over the cells around each.

    Raises:
        MeshError: cells of no area, or a fold.
    """
    element = scalar_element(_KIND, _DEGREE)
    gradients: Floats = element.tabulate(1, element.points)[1:, :, :, 0]
    tangents = np.einsum("dpn,cni->dcpi", gradients, surface.points[surface.cells])
    normals = np.cross(tangents[0], tangents[1])
    lengths = np.linalg.norm(normals, axis=2, keepdims=True)
    if not (lengths > 1e-12 * np.linalg.norm(tangents, axis=3).prod(axis=0)[..., None]).all():
        _refuse(surface.path, "has cells without area", "Mesh it again with another size.")
    normals = normals / lengths
    sums = np.zeros_like(surface.points)
    np.add.at(sums, surface.cells, normals)
    means = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-300)
    cosines = (normals * means[surface.cells]).sum(axis=2)
    if cosines.min() < np.cos(np.radians(_SHARPEST / 2)):
        cell, local = np.unravel_index(cosines.argmin(), cosines.shape)
        angle = 2 * np.degrees(np.arccos(np.clip(cosines.min(), -1, 1)))
        node = surface.node_tags[surface.cells[cell, local]]
        text = (
            f"has a fold of about {angle:.0f}° at node {node}, where a shell has no normal (at most {_SHARPEST:.0f}°)"
        )
        _refuse(surface.path, text, "Round it off with cells of degree 2 and a finer mesh, or mesh a solid.")
    return np.asarray(means)


def _refuse(path: Path, text: str, advice: str) -> NoReturn:
    raise MeshError(f"{path}: the surface {text}", advice)
