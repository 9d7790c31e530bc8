"""A mesh as it was read: plain arrays on rank 0, in the order and with the tags of the file that it came from."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

type Ints = npt.NDArray[np.int64]
type Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Group:
    """A named set of cells (``dim`` 3) or facets (``dim`` 2); ``members`` are rows of the source's cells or facets."""

    name: str
    dim: int
    tag: int
    members: Ints


@dataclass(frozen=True)
class MeshSource:
    """Nodes, cells and named groups of one mesh; every array is empty on ranks other than 0.

    ``points`` (n, 3) in metres; ``cells`` (m, k) and ``facets`` (f, l) are rows of ``points``, vertices first, in the
    node order of DOLFINx. ``facets`` are only those that a group names.
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
    thin_groups: tuple[str, ...] = ()  # names of groups of points and curves, which are no regions

    def header(self) -> MeshSource:
        """The same source without its data: what ranks other than 0 know."""
        return dataclasses.replace(
            self,
            points=self.points[:0],
            node_tags=self.node_tags[:0],
            cells=self.cells[:0],
            cell_tags=self.cell_tags[:0],
            facets=self.facets[:0],
            groups=tuple(dataclasses.replace(g, members=g.members[:0]) for g in self.groups),
        )

    def in_metres(self, unit: float) -> MeshSource:
        """The same mesh, its coordinates having been given in ``unit`` (m)."""
        return self if unit == 1.0 else dataclasses.replace(self, points=self.points * unit)

    def without_unused_nodes(self) -> MeshSource:
        """Drop the nodes that no cell has (centres of arcs, left-overs of surfaces); the others keep order and tags."""
        used = np.zeros(len(self.points), dtype=bool)
        used[self.cells] = True
        if used.all():
            return self
        # A facet on dropped nodes belongs to no cell: -1 lets the check of facets say so.
        new = np.where(used, np.cumsum(used) - 1, -1)
        return dataclasses.replace(
            self,
            points=self.points[used],
            node_tags=self.node_tags[used],
            cells=new[self.cells],
            facets=new[self.facets],
        )
