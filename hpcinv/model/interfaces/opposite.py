"""What lies opposite to the first surface of an interface: another surface of the mesh, or a rigid obstacle.

A rigid obstacle has no unknowns. Opposite to each quadrature point of the first surface is the nearest point of the
obstacle, and gaps, pressures and friction are along the direction out of the obstacle. So the mean gaps, tractions and
their stiffness are an interface's whose second surface does not deform.
"""

from __future__ import annotations

from typing import Any, Protocol

import basix
import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.source import Floats
from hpcinv.model.interfaces.facets import FacetKind, Facets, RegionFacets, gathered
from hpcinv.model.interfaces.node_gaps import NodeGaps
from hpcinv.model.interfaces.one_body import OneBody
from hpcinv.model.interfaces.segments import OPPOSITE, Segments, facing_pairs, segments
from hpcinv.model.obstacle_surface import ObstacleSurface

_MORE = 2
"""Degrees of quadrature on facets opposite to an obstacle, in addition to twice the displacement's. Lowered, curved
facets lose digits."""


class _NoNodes(FacetKind):
    """Facets without nodes, of a surface that does not deform."""

    def values(self, points: Floats) -> Floats:
        return np.zeros((3, len(points), 0))


_NO_FACETS = Facets(
    _NoNodes("triangle", 1),
    np.zeros((1, 0), dtype=np.int64),
    np.zeros((1, 0, 3), dtype=np.int64),
    np.zeros((1, 0, 3)),
    np.ones(1),
)


class Opposite(Protocol):
    """The other side of an interface; methods are collective.

    Attributes:
        fixes_normals: whether normals are the obstacle's, which pressures do not turn.
    """

    fixes_normals: bool

    def facets(self, nodes: Floats, u: Floats | None) -> Facets:
        """Return its facets of all ranks where the geometry nodes are, plus a displacement of the nodes."""

    def segments(self, first: Facets, second: Facets, reach: float, *, loaded: bool) -> Segments:
        """Return where it faces the first surface.

        Args:
            reach: largest distance, in radii of the second surface's largest facet.
            loaded: whether this is where it is loaded, else where it is unloaded.
        """

    def shift(self) -> Floats:
        """Return its motion (3,) from the unloaded state, scaled, in addition to the motion of its nodes."""

    def node_gaps(self, first: Facets, second: Facets, owned: int, comm: MPI.Intracomm, *, loaded: bool) -> NodeGaps:
        """Return the gaps at nodes."""


class OppositeSurface:
    """Another surface of the mesh.

    Args:
        share_nodes: whether both may share nodes.
        one_body: surfaces that belong to the same body.
    """

    fixes_normals = False

    def __init__(
        self, region: RegionFacets, comm: MPI.Intracomm, *, share_nodes: bool, one_body: OneBody | None = None
    ) -> None:
        self._region, self._comm, self._share_nodes, self._one_body = region, comm, share_nodes, one_body

    def facets(self, nodes: Floats, u: Floats | None) -> Facets:
        return gathered(self._region.at(nodes, u), self._comm)

    def segments(self, first: Facets, second: Facets, reach: float, *, loaded: bool) -> Segments:
        farthest = reach * float(second.radii.max(initial=0.0))
        if self._one_body is not None and self._one_body.is_one_surface:
            self._one_body.choose_sides(*facing_pairs(second, farthest, self._one_body))
        return segments(first, second, farthest, share_nodes=self._share_nodes, one_body=self._one_body)

    def shift(self) -> Floats:
        return np.zeros(3)

    def node_gaps(self, first: Facets, second: Facets, owned: int, comm: MPI.Intracomm, *, loaded: bool) -> NodeGaps:
        return NodeGaps.of_surfaces(first, second, owned, comm, self._one_body)


class OppositeObstacle:
    """A rigid obstacle, which may travel.

    Args:
        sign: of the kinematics: a given shape has the obstacle at the end of its travel.
    """

    fixes_normals = True

    def __init__(self, obstacle: ObstacleSurface, sign: int) -> None:
        self.obstacle, self._sign = obstacle, sign

    def facets(self, nodes: Floats, u: Floats | None) -> Facets:
        return _NO_FACETS

    def shift(self) -> Floats:
        return self.obstacle.shift()

    def _place(self, *, loaded: bool) -> Floats:
        """Return its displacement (3,) where the body is loaded or unloaded."""
        if self._sign > 0:
            return self.obstacle.shift() if loaded else np.zeros(3)
        return self.obstacle.travel - (0.0 if loaded else self.obstacle.shift())

    def segments(self, first: Facets, second: Facets, reach: float, *, loaded: bool) -> Segments:
        kind = first.kind
        cell = basix.CellType[kind.kind]
        points, weights = basix.make_quadrature(cell, 2 * kind.degree + _MORE)
        count, each = len(first), len(points)
        x, one, other = np.einsum("dqk,nki->dnqi", kind.values(points), first.points)
        area = np.cross(one, other) * first.signs[:, None, None]
        size = np.linalg.norm(area, axis=2)
        outer = (area / np.where(size > 0, size, 1.0)[:, :, None]).reshape(-1, 3)
        x = x.reshape(-1, 3)
        place = self._place(loaded=loaded)
        gaps, out = self.obstacle.distances(x - place)
        known = np.isfinite(out).all(axis=1) & np.isfinite(gaps)
        good = known & (np.einsum("ni,ni->n", outer, np.where(known[:, None], out, 0.0)) < OPPOSITE)
        facets = np.repeat(np.arange(count), each)[good]
        places = np.tile(points, (count, 1))[good]
        return Segments(
            facets,
            np.zeros(len(facets), dtype=np.int64),
            places,
            places,
            (size * weights).ravel()[good],
            -out[good],
            gaps[good],
            x[good] - gaps[good, None] * out[good],
        )

    def node_gaps(self, first: Facets, second: Facets, owned: int, comm: MPI.Intracomm, *, loaded: bool) -> NodeGaps:
        everywhere = gathered(first, comm)
        _, chosen = np.unique(everywhere.nodes, return_index=True)
        chosen = chosen[comm.rank :: comm.size]
        points = everywhere.points.reshape(-1, 3)[chosen]
        gaps, out = self.obstacle.distances(points - self._place(loaded=loaded))
        columns = everywhere.unknowns.reshape(-1, 3)[chosen][:, None]
        rows: tuple[Any, ...] = (gaps, points, -out, columns, np.full((len(points), 1), -1.0))
        return NodeGaps([rows], owned, comm)
