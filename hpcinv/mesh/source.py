"""A mesh as it was read: plain arrays, in the order and with the tags of its file."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Self

import numpy as np
import numpy.typing as npt

from hpcinv.base.quantity.arrays import Floats as Floats
from hpcinv.base.quantity.arrays import Ints as Ints
from hpcinv.job.body_kinds import SOLID
from hpcinv.job.shell_section import Shell

type Place = Literal["nodes", "cells"]

NO_CAD = "the true surface is not known"
MASK_BITS = 31
"""groups in a word of `MeshSource.masks`, which DOLFINx distributes as 32-bit numbers with a sign"""
COMPONENTS = (1, 3, 9)  # of scalars, vectors and tensors (row by row)


@dataclass(frozen=True)
class Group:
    """A named set of cells (``dim`` 3) or facets (``dim`` 2); ``members`` are rows of the source's cells or facets."""

    name: str
    dim: int
    tag: int
    members: Ints


@dataclass(frozen=True)
class DataArray:
    """Values (n, components) at the nodes or in the cells of a mesh; ``is_integer`` if the file has integers."""

    name: str
    place: Place
    values: Floats
    is_integer: bool = False


def data_arrays(candidates: Iterable[tuple[str, Place, npt.NDArray[np.generic]]]) -> dict[str, DataArray]:
    """Numeric arrays of 1, 3 or 9 components among the arrays (n,) or (n, components) of a file.

    If nodes and cells have arrays of the same name, these are renamed ``NAME (nodes)`` and ``NAME (cells)``.
    """
    kept: dict[tuple[str, Place], npt.NDArray[np.generic]] = {}
    for name, place, values in candidates:
        rows = values[:, None] if values.ndim == 1 else values
        if rows.dtype.kind in "fiu" and rows.ndim == 2 and rows.shape[1] in COMPONENTS:
            kept[name, place] = rows
    arrays = []
    for (name, place), rows in kept.items():
        both = {(name, "nodes"), (name, "cells")} <= kept.keys()
        full_name = f"{name} ({place})" if both else name
        arrays.append(DataArray(full_name, place, rows.astype(np.float64), rows.dtype.kind in "iu"))
    return {array.name: array for array in arrays}


@dataclass(frozen=True)
class CadSurface:
    """Facets of a mesh, and the nearest points of the surfaces of its CAD model.

    Attributes:
        vertices: tags (f, v) of the vertices of each facet.
        nodes: points (f, l, 3) of the surfaces, in m, next to the nodes that a geometry of the ``degree`` would have
            on the facets, in the node order of DOLFINx.
    """

    degree: int
    vertices: Ints
    nodes: Floats


@dataclass(frozen=True)
class SurfaceCells:
    """All surface cells of a mesh file, and integers in them.

    Attributes:
        nodes: as `MeshSource.facets`, of the mesh as it was read.
        vertex_tags: tags (f, v) of their vertices, which remain when the nodes are numbered anew.
        values: (f,) by name of the array.
    """

    nodes: Ints
    vertex_tags: Ints
    values: Mapping[str, Ints]


@dataclass(frozen=True)
class MeshSource:
    """Nodes, cells and named groups of one mesh; every array is empty on ranks other than 0.

    Of a partitioned mesh each rank has some rows of every array, in rank order; ``parts`` are then the global rows at
    which its parts begin, followed by the number of cells.

    ``points`` (n, 3) are in metres; ``cells`` (m, k) and ``facets`` (f, l) contain global rows of ``points``, vertices
    first, in the node order of DOLFINx. ``facets`` has only facets of groups. ``unit`` (m) is the length unit of the
    file, by the file itself or by the job; ``None`` is unknown, and taken as metres.
    """

    path: Path
    kind: str
    degree: int
    points: Floats
    node_tags: Ints
    cells: Ints
    cell_tags: Ints
    facets: Ints
    groups: tuple[Group, ...] = ()
    thin_groups: tuple[str, ...] = ()  # names of groups of points and curves, which cannot be regions
    data: Mapping[str, DataArray] = field(default_factory=dict)  # by name; cell arrays have rows for ``cells`` only
    parts: tuple[int, ...] = ()
    unit: float | None = None
    voxel: float = 0.0  # size (m) of the voxels of the image from which it was made, 0 without one
    inputs: Mapping[str, str] = field(default_factory=dict)  # files that its generator read, see `files.inputs`
    notes: tuple[str, ...] = ()  # what the reader did with the file, or did not use
    surface_cells: SurfaceCells | None = None  # with integers, in files that have such
    nodes_per_cell: int = 0  # of the elements in the file of another program; 0: as many as in ``cells``
    surface: CadSurface | None = None  # of the CAD model that was meshed, if there is one
    midsurface: MeshSource | None = None  # of a shell, whose groups of cells have ``dim`` 3, and of edges 2
    shell: Shell | None = None  # its section of the job
    body_kind: str = SOLID.name
    layers: int = 1  # of cells around a surface
    read_as: tuple[MeshSource, ...] = ()  # cells of each kind that a surface had in its file, before they were parted
    slenderness: float = 1.0  # of a shell: mean diameter of its cells by their thickness
    thickness: float = 0.0  # of a shell: mean (m); 0 of other bodies
    is_thin: bool = False  # of a shell: so long that the tangent of its nodes has too large rounding errors

    @property
    def in_file(self) -> MeshSource:
        """The mesh that a file has: of a shell its surface."""
        return self.midsurface or self

    @property
    def is_partitioned(self) -> bool:
        """True if each rank has some rows of the mesh, and none has all."""
        return bool(self.parts)

    def labels(self, dim: int) -> Ints:
        """Index in ``groups`` of the last group of each facet (``dim`` 2) or cell (3), -1 for none."""
        label = np.full(len(self.cells if dim == 3 else self.facets), -1, dtype=np.int64)
        for i, group in enumerate(self.groups):
            if group.dim == dim:
                label[group.members] = i
        return label

    def groups_overlap(self, dim: int) -> bool:
        """Return whether a facet (``dim`` 2) or cell (3) of these rows is in several groups."""
        members = sum(len(group.members) for group in self.groups if group.dim == dim)
        return bool(members > np.count_nonzero(self.labels(dim) >= 0))

    def masks(self, dim: int) -> Ints:
        """Groups of each facet (``dim`` 2) or cell (3), (n, words): bit b of word w is ``groups[31 w + b]``."""
        masks = np.zeros((len(self.cells if dim == 3 else self.facets), mask_words(self.groups)), dtype=np.int64)
        for i, group in enumerate(self.groups):
            if group.dim == dim:
                masks[group.members, i // MASK_BITS] |= 1 << (i % MASK_BITS)
        return masks

    def select(self, nodes: Ints, cells: Ints, facets: Ints) -> Self:
        """The mesh with these rows of nodes, cells and facets, in this order; other nodes are replaced by -1."""
        number = _positions(nodes, len(self.points))
        place = {3: _positions(cells, len(self.cells)), 2: _positions(facets, len(self.facets))}
        members = [place[group.dim][group.members] for group in self.groups]
        rows = {"nodes": nodes, "cells": cells}
        return dataclasses.replace(
            self,
            points=self.points[nodes],
            node_tags=self.node_tags[nodes],
            cells=number[self.cells[cells]],
            cell_tags=self.cell_tags[cells],
            facets=number[self.facets[facets]],
            groups=tuple(
                dataclasses.replace(g, members=np.sort(m[m >= 0])) for g, m in zip(self.groups, members, strict=True)
            ),
            data={name: dataclasses.replace(a, values=a.values[rows[a.place]]) for name, a in self.data.items()},
        )

    def header(self) -> Self:
        """The same source with empty arrays, for ranks other than 0."""
        none: Ints = np.zeros(0, dtype=np.int64)
        middle = self.midsurface and self.midsurface.header()
        return dataclasses.replace(self.select(none, none, none), surface=None, surface_cells=None, midsurface=middle)

    def convert_to_metres(self, unit: float) -> Self:
        """The same mesh in metres, from coordinates in ``unit`` (m)."""
        if unit == 1.0:
            return dataclasses.replace(self, unit=unit)
        surface = self.surface and dataclasses.replace(self.surface, nodes=self.surface.nodes * unit)
        return dataclasses.replace(self, points=self.points * unit, surface=surface, unit=unit)

    def drop_unused_nodes(self) -> Self:
        """The same mesh without nodes of no cell (such as centres of arcs); the others keep order and tags."""
        used = np.zeros(len(self.points), dtype=bool)
        used[self.cells] = True
        if used.all():
            return self
        # The check of facets reports facets with removed nodes, which belong to no cell.
        return self.select(np.flatnonzero(used), np.arange(len(self.cells)), np.arange(len(self.facets)))

    def nodal_data(self, change: Callable[[Floats], Floats]) -> dict[str, DataArray]:
        """The data arrays, with ``change`` applied to the values at nodes."""
        return {
            name: dataclasses.replace(a, values=change(a.values)) if a.place == "nodes" else a
            for name, a in self.data.items()
        }


@dataclass(frozen=True)
class FinerGeometry:
    """The same cells with a geometry of a higher degree.

    Attributes:
        unknown: reason why the true geometry is unknown; empty if it is known.
        source: the cells; ``None`` if the geometry of the mesh is the true one, or if that is unknown.
    """

    unknown: str = ""
    source: MeshSource | None = None


def mask_words(groups: Sequence[object]) -> int:
    """Return the number of words that say in which of some groups an entity is."""
    return max(1, -(-len(groups) // MASK_BITS))


def in_mask(masks: Ints, group: int) -> npt.NDArray[np.bool_]:
    """Return which rows of masks (n, words) have the group with an index."""
    return np.asarray(masks[:, group // MASK_BITS] >> (group % MASK_BITS) & 1 > 0)


def distinct_tags(groups: Sequence[Group]) -> tuple[Group, ...]:
    """Return groups whose tags differ within a dimension and are valid in all formats: from 1 to 2³¹ - 1.

    Tags that are valid and not taken by an earlier group are kept.
    """
    kept: list[Group] = []
    for group in groups:
        taken = {other.tag for other in kept if other.dim == group.dim}
        if not 0 < group.tag < 2**31 or group.tag in taken:
            later = {other.tag for other in groups if other.dim == group.dim}
            tag = next(number for number in itertools.count(1) if number not in taken | later)
            group = dataclasses.replace(group, tag=tag)
        kept.append(group)
    return tuple(kept)


def _positions(rows: Ints, count: int) -> Ints:
    """Position among ``rows`` of each of ``count`` rows, -1 for rows that are not among them."""
    position = np.full(count, -1, dtype=np.int64)
    position[rows] = np.arange(len(rows))
    return position
