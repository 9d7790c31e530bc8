"""Quadrilaterals of degree 2 from the cells of a surface, without a change of the surface.

A triangle becomes three quadrilaterals, with its middle as a common vertex; the quadrilaterals next to triangles become
four. A map of degree 2 stays one: each part is a bilinear map into the cell, and a composition of the two is a map of
degree 2 in each coordinate.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.source import DataArray, Floats, Group, Ints, MeshSource

_RESOLUTION = 2**20
"""steps of a weight of 1, within which weights of a node in neighbouring cells are equal; raised, rounding errors make
two nodes of one"""


@dataclasses.dataclass(frozen=True)
class _Pattern:
    """Parts of a cell of degree 2: nodes as weights (points, nodes) of the cell's, and their numbers (parts, nodes)."""

    weights: Floats
    parts: Ints

    @classmethod
    def of_cell(cls, kind: str, degree: int, *, split: bool) -> "_Pattern":
        part = "interval" if kind == "interval" else "quadrilateral"
        shapes = scalar_element(part, 1).tabulate(0, scalar_element(part, 2).points)[0, :, :, 0]
        places = np.concatenate([shapes @ corners for corners in _corners(kind, split=split)])
        points, numbers = np.unique(np.round(places, 9), axis=0, return_inverse=True)
        exact = np.empty_like(points)
        exact[numbers.ravel()] = places
        weights = scalar_element(kind, degree).tabulate(0, exact)[0, :, :, 0]
        return cls(np.where(np.abs(weights) < 1e-12, 0, weights), numbers.reshape(-1, shapes.shape[0]))


def _corners(kind: str, *, split: bool) -> list[Floats]:
    """Reference vertices of the parts of a cell."""
    vertices: Floats = scalar_element(kind, 1).points
    if not split:
        return [vertices]
    middle = vertices.mean(axis=0)
    if kind == "triangle":
        edges = [(vertices + vertices[np.roll(np.arange(3), by)]) / 2 for by in (-1, 1)]
        return [np.array([vertices[i], edges[0][i], edges[1][i], middle]) for i in range(3)]
    return [vertices / 2 + corner / 2 for corner in vertices]


def quadrilaterals(surfaces: Sequence[MeshSource]) -> MeshSource:
    """Return a surface of quadrilaterals of degree 2, whose first nodes are the given ones, in their order.

    Args:
        surfaces: the cells of each kind, triangles or quadrilaterals of degree 1 or 2, with the same nodes and edges.
    """
    if [(s.kind, s.degree) for s in surfaces] == [("quadrilateral", 2)]:
        return surfaces[0]
    parted = _parted(surfaces, split=any(surface.kind == "triangle" for surface in surfaces))
    notes = (*parted.notes, _note(surfaces, len(parted.cells)))
    return dataclasses.replace(parted, notes=notes, read_as=tuple(surfaces))


def halved(surface: MeshSource) -> MeshSource:
    """Return a surface with each quadrilateral of degree 2 cut into four; its first nodes are the given ones."""
    return dataclasses.replace(_parted([surface], split=True), read_as=())


def _parted(surfaces: Sequence[MeshSource], *, split: bool) -> MeshSource:
    """Return the quadrilaterals of all cells, cut into several or not."""
    first = surfaces[0]
    patterns = [_Pattern.of_cell(s.kind, s.degree, split=split) for s in surfaces]
    edge = _Pattern.of_cell("interval", first.degree, split=split)
    count = len(first.points)
    blocks = [(p, s.cells) for p, s in zip(patterns, surfaces, strict=True)] + [(edge, first.facets)]
    keys, weights = (
        np.concatenate(columns)
        for columns in zip(
            _keys(np.ones((1, 1)), np.arange(count)[:, None]),
            *(_keys(p.weights, cells) for p, cells in blocks),
            strict=True,
        )
    )
    distinct, sample, number = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(sample, kind="stable")  # the given nodes first
    numbers = np.argsort(order)[number.ravel()]
    width, chosen = keys.shape[1] // 2, distinct[order]
    rows, places = np.nonzero(chosen[:, :width] >= 0)
    sources, shares = chosen[rows, places], weights[sample[order]][rows, places]

    def interpolated(values: Floats) -> Floats:
        result = np.zeros((len(chosen), values.shape[1]))
        np.add.at(result, rows, shares[:, None] * values[sources])
        return result

    parts, start = list[Ints](), count
    for pattern, cells in blocks:
        size = len(cells) * len(pattern.weights)
        here = numbers[start : start + size].reshape(len(cells), len(pattern.weights))
        parts.append(here[:, pattern.parts].reshape(-1, pattern.parts.shape[1]))
        start += size
    cells, facets = np.concatenate(parts[:-1]), parts[-1]
    return dataclasses.replace(
        first,
        kind="quadrilateral",
        degree=2,
        points=interpolated(first.points),
        node_tags=np.concatenate(
            [first.node_tags, first.node_tags.max(initial=0) + 1 + np.arange(len(chosen) - count)]
        ),
        cells=cells,
        cell_tags=np.arange(1, len(cells) + 1),
        facets=facets,
        groups=_groups(surfaces, [len(p.parts) for p in patterns], len(edge.parts)),
        data=_data(surfaces, [len(p.parts) for p in patterns], interpolated),
    )


def _note(surfaces: Sequence[MeshSource], count: int) -> str:
    given = " and ".join(f"{len(s.cells):,} {s.kind}s of degree {s.degree}" for s in surfaces)
    return f"the shell has {count:,} quadrilaterals of degree 2, made of {given} on the same surface"


def _keys(weights: Floats, cells: Ints) -> tuple[Ints, Floats]:
    """Keys (c · points, 18) of nodes of cells, the same for a node that several cells have, and weights (…, 9).

    A key has the rows of the given nodes between which a node is, -1 for none, and their rounded weights.
    """
    rows = np.where(weights != 0, cells[:, None, :], -1).reshape(-1, cells.shape[1])
    shares = np.broadcast_to(weights, (len(cells), *weights.shape)).reshape(rows.shape)
    order = np.argsort(-rows, axis=1, kind="stable")
    keys, sorted_shares = np.full((len(rows), 18), -1, dtype=np.int64), np.zeros((len(rows), 9))
    keys[:, : rows.shape[1]] = np.take_along_axis(rows, order, axis=1)
    sorted_shares[:, : rows.shape[1]] = np.take_along_axis(shares, order, axis=1)
    keys[:, 9:] = np.rint(sorted_shares * _RESOLUTION)
    return keys, sorted_shares


def _groups(surfaces: Sequence[MeshSource], parts: Sequence[int], edge_parts: int) -> tuple[Group, ...]:
    """Groups of edges once, and of cells over all kinds."""
    groups, start = list[Group](), 0
    members: dict[int, list[Ints]] = {}
    for surface, count in zip(surfaces, parts, strict=True):
        for i, group in enumerate(surface.groups):
            if group.dim == 3:
                members.setdefault(i, []).append(start + _inside(group.members, count))
        start += count * len(surface.cells)
    for i, group in enumerate(surfaces[0].groups):
        inside = _inside(group.members, edge_parts) if group.dim == 2 else np.sort(np.concatenate(members[i]))
        groups.append(dataclasses.replace(group, members=inside))
    return tuple(groups)


def _inside(members: Ints, parts: int) -> Ints:
    return np.asarray((members[:, None] * parts + np.arange(parts)).ravel())


def _data(
    surfaces: Sequence[MeshSource], parts: Sequence[int], interpolated: Callable[[Floats], Floats]
) -> dict[str, DataArray]:
    """Nodal arrays by interpolation, and arrays of cells that all kinds have."""
    data: dict[str, DataArray] = {}
    for name, array in surfaces[0].data.items():
        if array.place == "nodes":
            data[name] = dataclasses.replace(array, values=interpolated(array.values))
        elif all(name in surface.data for surface in surfaces):
            values = [np.repeat(s.data[name].values, n, axis=0) for s, n in zip(surfaces, parts, strict=True)]
            data[name] = dataclasses.replace(array, values=np.concatenate(values))
    return data
