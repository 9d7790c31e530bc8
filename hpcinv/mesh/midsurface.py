"""The body of a shell: layers of hexahedra of degree 2 around a surface of quadrilaterals.

A node of the surface has a column of three nodes, at the inner face, half way and at the outer face. A map of the
body is quadratic in the distance ``ζ`` from the surface: ``y = y₀ + ζ y₁ + ζ² y₂``, with the director ``y₁`` and the
quadratic part ``y₂``, without which a law of three dimensions would be too stiff in bending. The values of the three
nodes determine ``y₀``, ``y₁`` and ``y₂``: a displacement of degree 2 is the displacement of a shell with director, with
the strains of its solid, and `LayerDegree` is the quadrature by which it does not lock. Layers of other materials are
further layers of hexahedra, each with a director of its own.

Source: Chapelle, Ferent & Bathe, Math. Models Methods Appl. Sci. 14, 105–142, 2004 (elements of this kind).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from hpcinv.base.quantity.expressions import KeyPath
from hpcinv.base.quantity.spatial_fields import ByData, ByFormula, Field
from hpcinv.base.quantity.units import readable
from hpcinv.base.reading.mesh_format import INNER, OUTER
from hpcinv.errors import MeshError
from hpcinv.job.body_kinds import SHELL
from hpcinv.job.mesh_section import ArrayLabels, MeshSpec
from hpcinv.job.shell_section import Shell
from hpcinv.mesh.cells import LayerDegree, mirrored, scalar_element, sub_entities, vertex_count
from hpcinv.mesh.facet_groups import join_facets
from hpcinv.mesh.kind_source import KindSource
from hpcinv.mesh.quadrilaterals import halved
from hpcinv.mesh.readers import read_surface
from hpcinv.mesh.source import DataArray, Floats, Group, Ints, MeshSource, distinct_tags
from hpcinv.mesh.surface_normals import DEGREE, KIND, NormalRates, nodal_normals, place_text, refuse, surface_tangents
from hpcinv.mesh.topology import edge_neighbours, neighbour_signs, unique_rows, vertex_sets

_NARROW = 1e-3
"""Length of an edge by the thickness below which a note names it: at 5e-5 the residual was 4e-5 of the load."""

_THIN, _THINNEST = 3e3, 1.5e4
"""Length of a surface by its thickness. Above the first, the tangent of the nodes has rounding errors with which
Newton's method does not converge, and one layer has `DirectorUnknowns`. Above the second, rounded positions leave a
residual that fails the certificate (0.002 of the load at 30,000)."""


class ShellSource(KindSource):
    """The surface of a shell, and its body."""

    def read(self, path: Path, labels: ArrayLabels | None) -> MeshSource:
        return read_surface(path, labels)

    def oriented(self, source: MeshSource) -> MeshSource:
        return source

    def labelled(self, source: MeshSource, labels: ArrayLabels) -> MeshSource:
        return source

    def body(self, source: MeshSource, spec: MeshSpec) -> MeshSource:
        assert spec.shell is not None
        return thicken(source, spec.shell)

    def cut(self, body: MeshSource) -> MeshSource:
        return halved_shell(body)

    def quadrature(self, body: MeshSource, degree: int) -> int:
        return LayerDegree(degree, body.slenderness)

    def corrects_shear(self, body: MeshSource, degree: int) -> bool:
        return body.layers == 1 and degree == DEGREE

    def surface_heights(self, body: MeshSource, cells: Ints, count: int) -> Floats:
        assert body.shell is not None
        assert body.shell.surface_level is not None
        return np.asarray(body.shell.surface_level / 2 - cells * body.layers // count, dtype=np.float64)

    def node_rates(self, body: MeshSource, place: KeyPath, value: float) -> Floats:
        """By the thickness: nodes of a column lie at fixed shares of it from the given surface."""
        surface, points = body.midsurface, body.points
        assert surface is not None
        columns: Floats = points - np.tile(surface.points, (len(points) // max(len(surface.points), 1), 1))
        return columns / value

    def moved(self, body: MeshSource, shape: MeshSource) -> Floats:
        return moved_levels(body, shape)

    def node_direction(self, body: MeshSource, nodes: Floats, rates: Floats) -> Floats:
        surface, heights = _moved_surface(body, nodes), _heights(body)
        return np.asarray(rates + heights * NormalRates(surface).along(rates)).reshape(-1, 3)

    def node_gradient(self, body: MeshSource, nodes: Floats, gradient: Floats) -> Floats:
        by_level = gradient.reshape(-1, len(nodes), 3)
        by_normals = (_heights(body) * by_level).sum(axis=0)
        return np.asarray(by_level.sum(axis=0) + NormalRates(_moved_surface(body, nodes)).transposed(by_normals))

    def saved(self, body: MeshSource, points: Floats, more: Mapping[str, DataArray]) -> tuple[MeshSource, Floats]:
        return surface_source(body, points, more)


def thicken(surface: MeshSource, shell: Shell) -> MeshSource:
    """Return the body of a shell, whose nodes are one copy of the surface's for each level, from the inner face on.

    The outer face is where the normals of the cells point to: outwards if the surface is closed, else on the side of
    the first cell's normal, by the order of its nodes. A group of cells ``NAME`` has further groups ``NAME|outer`` and
    ``NAME|inner`` of its faces, and a group of edges becomes one of facets through the thickness. A layer is a group.

    Raises:
        MeshError: the surface has folds or junctions, or only one side; or it lacks the data of its faces.
    """
    names = [OUTER, INNER, *shell.layers]
    if taken := [group.name for group in surface.groups if group.name in names]:
        text = f"has a physical group '{taken[0]}', which is the name of a face or layer of the shell"
        refuse(surface.path, text, "Give the group another name.")
    surface = dataclasses.replace(surface, cells=_oriented(surface))
    count = len(surface.points)
    surface, columns, thickness = _levels(surface, shell)
    layers = range(len(columns) // 2)
    length = _length_by_thickness(surface, thickness, _THIN if shell.layers else _THINNEST)
    _check_faces(surface, columns[0], columns[-1])
    starts = [2 * layer * count for layer in layers]
    cells = np.concatenate([start + _columns(KIND, "hexahedron", surface.cells, count) for start in starts])
    edges = np.concatenate([start + _columns("interval", KIND, surface.facets, count) for start in starts])
    sheet = surface.cells[:, _order(KIND, KIND)]
    facets = np.concatenate([edges, sheet, sheet + (len(columns) - 1) * count])
    return dataclasses.replace(
        surface,
        kind="hexahedron",
        points=np.concatenate([surface.points + column for column in columns]),
        node_tags=_repeated_tags(surface.node_tags, len(columns)),
        cells=cells,
        cell_tags=_repeated_tags(surface.cell_tags, len(layers)),
        facets=facets,
        groups=distinct_tags(_groups(surface, shell, len(layers), len(edges))),
        data=_data(surface, shell),
        notes=surface.notes + _narrow_cells(surface, thickness),
        midsurface=surface,
        shell=shell,
        body_kind=SHELL.name,
        layers=len(layers),
        slenderness=_slenderness(surface, float(thickness.mean())) if len(thickness) else 1.0,
        thickness=float(thickness.mean()) if len(thickness) else 0.0,
        is_thin=length > _THIN,
    )


def _levels(surface: MeshSource, shell: Shell) -> tuple[MeshSource, list[Floats], Floats]:
    """Return the surface, turned if its data say so, and by node the distances of the levels and the thickness."""
    normals = nodal_normals(surface)
    if shell.thickness is not None:
        thickness = _thickness(surface, shell.thickness)
        return surface, [(place - shell.surface_place) * thickness * normals for place in shell.levels], thickness
    columns = [_column(surface, shell, level) for level in range(len(shell.levels))]
    through = columns[-1] - columns[0]
    if (through * normals).sum() < 0:  # by the order of their nodes, cells have the other normal
        surface = dataclasses.replace(surface, cells=mirrored(KIND, DEGREE, surface.cells))
    return surface, columns, np.linalg.norm(through, axis=1, keepdims=True)


def _groups(surface: MeshSource, shell: Shell, layers: int, edges: int) -> list[Group]:
    """Return the groups of the body: of the surface through all layers, of layers, and of its faces.

    Args:
        edges: number of facets through the thickness; the inner face follows them, then the outer one.
    """
    sizes, groups = {3: len(surface.cells), 2: len(surface.facets)}, list[Group]()
    for group in surface.groups:
        members = [group.members + layer * sizes[group.dim] for layer in range(layers)]
        groups.append(dataclasses.replace(group, members=np.concatenate(members)))
    count, every = len(surface.cells), np.arange(len(surface.cells))
    groups.extend(Group(name, 3, 0, layer * count + every) for layer, name in enumerate(shell.layers))
    for name, first in ((INNER, edges), (OUTER, edges + count)):
        groups.append(Group(name, 2, 0, first + every))
        parts = [group for group in surface.groups if group.dim == 3]
        groups.extend(Group(f"{group.name}|{name}", 2, 0, first + group.members) for group in parts)
    return groups


def _data(surface: MeshSource, shell: Shell) -> dict[str, DataArray]:
    """Return arrays of the body, constant through the thickness or linear from ``NAME_inner`` to ``NAME_outer``."""
    levels, arrays = np.array(shell.levels), dict[str, DataArray]()
    for name, array in surface.data.items():
        times = len(levels) if array.place == "nodes" else len(levels) // 2
        arrays[name] = dataclasses.replace(array, values=np.tile(array.values, (times, 1)))
    shares = ((levels - levels[0]) / (levels[-1] - levels[0]))[:, None, None]
    for name, outer in surface.data.items():
        stem = name.removesuffix(f"_{OUTER}")
        inner = surface.data.get(f"{stem}_{INNER}")
        if stem != name and inner is not None and outer.place == inner.place == "nodes":
            through = inner.values + shares * (outer.values - inner.values)
            arrays[stem] = DataArray(stem, "nodes", through.reshape(-1, outer.values.shape[1]))
    return arrays


def _repeated_tags(tags: Ints, times: int) -> Ints:
    """Tags of as many copies, distinct if the given ones are."""
    step = int(tags.max(initial=0)) + 1 - int(tags.min(initial=0))
    return np.concatenate([tags + step * copy for copy in range(times)])


def _thickness(surface: MeshSource, given: float | Field) -> Floats:
    """Thickness (n, 1) at the nodes, in m; raises ``MeshError`` if it is not positive and finite."""
    match given:
        case ByData():
            array = surface.data.get(given.array)
            if array is None or array.place != "nodes" or array.values.shape[1] != 1:
                known = ", ".join(sorted(surface.data)) or "none"
                text = f"has no array '{given.array}' of numbers at the nodes (arrays: {known})"
                refuse(surface.path, text, "mesh.shell.thickness must be a number, a formula, or such an array.")
            values = array.values * given.factor
        case ByFormula():
            x, y, z = surface.points.T
            with np.errstate(all="ignore"):
                at_nodes = given.values_at({"x": x, "y": y, "z": z, "X": x, "Y": y, "Z": z})
            values = np.broadcast_to(at_nodes, x.shape)[:, None]
        case number:
            values = np.full((len(surface.points), 1), number)
    if not (np.isfinite(values) & (values > 0)).all():
        worst = np.argmin((np.isfinite(values) & (values > 0))[:, 0])
        value = float(values[worst, 0])
        shown = readable(value, "m") if np.isfinite(value) else value
        text = f"has a thickness of {shown} at {place_text(surface.points[worst])}"
        refuse(surface.path, text, "Correct mesh.shell.thickness: it must be positive and finite.")
    return np.asarray(values)


def _length_by_thickness(surface: MeshSource, thickness: Floats, most: float) -> float:
    """Return the length of the surface by the least thickness; raises ``MeshError`` if that is too much."""
    extent, least = float(np.linalg.norm(np.ptp(surface.points, axis=0))), float(thickness.min())
    long, thick = readable(extent, "m"), readable(least, "m")
    if least > extent:
        raise MeshError(
            f"{surface.path}: the shell is {thick} thick, and its surface only {long} long",
            "Numbers without a unit are in metres: write a unit in mesh.shell.thickness, such as '1 mm'.",
        )
    if extent > most * least:
        shown = f"{extent / least:,.0f}" if least else "infinitely many"
        text = f"is {long} long, {shown} times its thickness of {thick} (at most {most:,.0f})"
        refuse(
            surface.path, text, "Are 'thickness' and mesh.unit right? In thinner shells rounding errors are too large."
        )
    return extent / least


def _check_faces(surface: MeshSource, inner: Floats, outer: Floats) -> None:
    """Raise ``MeshError`` if a face of the shell lies beyond the centre of curvature, so that its cells are inside out.

    Args:
        inner: vectors (n, 3) from the nodes of the surface to the inner face.
        outer: the same of the outer face.
    """
    through = outer - inner
    for name, column in ((INNER, inner), (OUTER, outer)):
        tangents = surface_tangents(surface.cells, surface.points + column)
        volumes = (np.cross(tangents[0], tangents[1]) * through[surface.cells]).sum(axis=2)
        if (is_inverted := (volumes <= 0).any(axis=1)).any():
            cell, node = np.unravel_index(volumes.argmin(), volumes.shape)
            at = surface.cells[cell, node]
            thick = readable(float(np.linalg.norm(through[at])), "m")
            text = f"is too curved for a thickness of {thick} at {place_text(surface.points[at])}:"
            refuse(
                surface.path,
                f"{text} {np.count_nonzero(is_inverted)} cells of the {name} face are inside out",
                "Is the unit of mesh.shell.thickness right? Half of it, or all of it from a face to the other one, must"
                " be below the radius of curvature: take less, or mesh a solid.",
            )


def _narrow_cells(surface: MeshSource, thickness: Floats) -> tuple[str, ...]:
    """Return a note on the narrowest edge of a cell by its thickness, if it is below `_NARROW`."""
    corners = surface.cells[:, [0, 1, 3, 2]]
    lengths = np.linalg.norm(surface.points[corners] - surface.points[np.roll(corners, 1, axis=1)], axis=2)
    shares = lengths / thickness[corners, 0]
    if not shares.size or shares.min() >= _NARROW:
        return ()
    worst = np.unravel_index(shares.argmin(), shares.shape)
    width, place = readable(float(lengths[worst]), "m"), place_text(surface.points[corners[worst]])
    return (
        f"an edge at {place} is {width} long, {shares[worst]:.1g} of the thickness: rounding errors may leave a"
        " residual there; join its nodes",
    )


def _level_name(level: int, shell: Shell) -> str:
    """Name of the array of vectors from the surface to a level."""
    last = len(shell.levels) - 1
    return {0: INNER, last: OUTER}.get(level, f"level-{level}")


def _column(surface: MeshSource, shell: Shell, level: int) -> Floats:
    """Vectors (n, 3) from the surface to a level, of the arrays of the file."""
    is_surface = level == shell.surface_level
    return np.zeros_like(surface.points) if is_surface else _vectors(surface, _level_name(level, shell))


def _slenderness(surface: MeshSource, thickness: float) -> float:
    """Return the mean diameter of the cells by their thickness; 1 without cells."""
    corners = surface.points[surface.cells[:, :4]]
    diameters = np.linalg.norm(corners[:, 3] - corners[:, 0], axis=1)
    return float(diameters.mean() / thickness) if len(diameters) else 1.0


def surface_source(
    body: MeshSource, points: Floats, more: Mapping[str, DataArray] = MappingProxyType({})
) -> tuple[MeshSource, Floats]:
    """Return the surface of a shell with data of its body, and its nodes, for the nodes (n, 3) of the body.

    Data arrays ``outer`` and ``inner`` are the vectors from a node of the surface to the faces (m), ``director`` is the
    unit vector between the faces, and ``thickness`` their distance (m). Other levels have arrays as well.

    Args:
        more: further data of the body, which replace its own. Those at nodes are ``NAME_outer`` and ``NAME_inner``, on
            the faces, unless the surface has an array NAME.
    """
    surface, shell = body.midsurface, body.shell
    assert surface is not None
    assert shell is not None
    count = len(surface.points)
    shares = _surface_shares(shell)

    def at_surface(values: Floats) -> Floats:
        columns = values.reshape(len(shell.levels), count, -1)
        if shell.surface_level is not None:
            return np.asarray(columns[shell.surface_level])
        return np.asarray(np.tensordot(shares, columns, axes=1))

    levels, middle = points.reshape(len(shell.levels), count, 3), at_surface(points)
    through = levels[-1] - levels[0]
    thickness = np.linalg.norm(through, axis=1, keepdims=True)
    arrays = {_level_name(i, shell): level - middle for i, level in enumerate(levels) if i != shell.surface_level} | {
        OUTER: levels[-1] - middle,
        INNER: levels[0] - middle,
    }
    arrays |= {"thickness": thickness, "director": through / np.maximum(thickness, 1e-300)}
    face_data = {
        name: array
        for name, array in more.items()
        if array.place == "nodes" and (name not in body.data or f"{name}_{OUTER}" in surface.data)
    }
    data = {
        name: dataclasses.replace(
            array, values=at_surface(array.values) if array.place == "nodes" else array.values[: len(surface.cells)]
        )
        for name, array in {**body.data, **more}.items()
        if name not in face_data
    }
    for name, array in face_data.items():
        columns = array.values.reshape(len(shell.levels), count, -1)
        arrays |= {f"{name}_{OUTER}": columns[-1], f"{name}_{INNER}": columns[0]}
    data |= {name: DataArray(name, "nodes", values) for name, values in arrays.items()}
    return dataclasses.replace(surface, data=data), middle


def moved_levels(body: MeshSource, surface: MeshSource) -> Floats:
    """Return the nodes (n, 3) of a shell whose surface has moved, with the same thickness along the new normals (m).

    Args:
        surface: the midsurface of the body at other points.

    Raises:
        MeshError: the moved surface has cells of no area, or folds.
    """
    return np.asarray(surface.points + _heights(body) * nodal_normals(surface)).reshape(-1, 3)


def _heights(body: MeshSource) -> Floats:
    """Return the distances (levels, n, 1) of the nodes of a shell from its surface, along the director."""
    assert body.midsurface is not None
    levels = body.points.reshape(-1, len(body.midsurface.points), 3) - body.midsurface.points
    through = levels[-1] - levels[0]
    through = through / np.linalg.norm(through, axis=1, keepdims=True)
    return np.asarray((levels * through).sum(axis=2, keepdims=True))


def _moved_surface(body: MeshSource, nodes: Floats) -> MeshSource:
    assert body.midsurface is not None
    return dataclasses.replace(body.midsurface, points=nodes)


def halved_shell(body: MeshSource) -> MeshSource:
    """Return the body of a shell with each cell of its surface cut into four.

    Node ``n`` of a level of the given body is node ``n`` of that level. The others have the normals and the thickness
    of their place, where these are not data of the faces.
    """
    surface, shell = body.midsurface, body.shell
    assert surface is not None
    assert shell is not None
    return join_facets(thicken(halved(surface), shell))


def halved_values(body: MeshSource, values: Floats) -> Floats:
    """Return values at the nodes of the `halved_shell` from values (n, k) at the nodes of its body."""
    surface, shell = body.midsurface, body.shell
    assert surface is not None
    assert shell is not None
    levels, count = len(shell.levels), len(surface.points)
    columns = values.reshape(levels, count, -1).transpose(1, 0, 2).reshape(count, -1)
    carried = halved(dataclasses.replace(surface, data={"": DataArray("", "nodes", columns)})).data[""].values
    return np.asarray(carried.reshape(len(carried), levels, -1).transpose(1, 0, 2).reshape(levels * len(carried), -1))


def _surface_shares(shell: Shell) -> Floats:
    """Shares of the levels in a quantity at the surface, which is quadratic in each layer."""
    levels, place = np.array(shell.levels), shell.surface_place
    layer = min(int(np.searchsorted(levels[2::2], place)), len(levels) // 2 - 1)
    nodes = 2 * layer + np.arange(3)
    shares = np.zeros(len(levels))
    for node in nodes:
        others = levels[nodes[nodes != node]]
        shares[node] = ((place - others) / (levels[node] - others)).prod()
    return shares


def _vectors(surface: MeshSource, name: str) -> Floats:
    """Vectors (n, 3) of a data array; raises ``MeshError`` if there is none."""
    array = surface.data.get(name)
    if array is None or array.place != "nodes" or array.values.shape[1] != 3 or not np.isfinite(array.values).all():
        known = ", ".join(sorted(surface.data)) or "none"
        text = f"has no array '{name}' of vectors at all nodes (arrays: {known})"
        refuse(surface.path, text, "Give 'thickness' instead of 'director: data', or a shape file of a run.")
    return array.values


def _order(kind: str, flat: str) -> Ints:
    """Local node of ``flat`` cells above which each node of ``kind`` cells lies, which have one axis more or none."""
    columns, places = (scalar_element(k, DEGREE).points for k in (kind, flat))
    dim = places.shape[1]
    distances = np.abs(columns[:, None, :dim] - places[None]).max(axis=2)
    return np.asarray(distances.argmin(axis=1), dtype=np.int64)


def _columns(flat: str, kind: str, nodes: Ints, count: int) -> Ints:
    """Cells of one dimension more, whose last axis goes through the thickness."""
    height = np.rint(2 * scalar_element(kind, DEGREE).points[:, -1]).astype(np.int64)
    return np.asarray(nodes[:, _order(kind, flat)] + height * count)


def _oriented(surface: MeshSource) -> Ints:
    """Cells (c, 9) whose normals agree across edges, and point outwards if the surface is closed.

    Raises:
        MeshError: more than two cells share an edge, or the surface has only one side.
    """
    path, cells = surface.path, surface.cells
    local = sub_entities(KIND, 1)
    vertices, place = unique_rows(vertex_sets(cells[:, : vertex_count(KIND)], local))
    sharing = np.bincount(place, minlength=len(vertices))
    if (sharing > 2).any():
        middle = place_text(surface.points[vertices[np.argmax(sharing > 2)]].mean(axis=0))
        raise MeshError(
            f"{path}: more than two cells meet at {(sharing > 2).sum()} edges (first: at {middle})",
            "Such a junction has no single director: leave the third sheet out, or mesh a solid.",
        )
    one, other, agree = edge_neighbours(cells[:, local], place)
    sign, _ = neighbour_signs(one, other, agree, len(cells))
    if (sign[one] * agree != sign[other]).any():
        raise MeshError(f"{path}: the surface has only one side, as a Möbius strip", "Cut it, or mesh a solid.")
    if (sharing == 2).all():
        flat = surface.points[cells]
        areas = np.cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]) * sign[:, None]
        centre = surface.points.mean(axis=0)
        if ((flat[:, :4].mean(axis=1) - centre) * areas).sum() < 0:
            sign = -sign
    return np.where(sign[:, None] > 0, cells, mirrored(KIND, DEGREE, cells))
