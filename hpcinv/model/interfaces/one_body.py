"""Facets of one body that may press on each other.

Neighbours never do: facets that share a node, and facets on both sides of a wall, whose outer normals point away from
each other too. Which ones these are follows from the unloaded body, where no surface lies in another.
"""

from __future__ import annotations

import numpy as np

from hpcinv.base.quantity.arrays import Booleans
from hpcinv.errors import MeshError
from hpcinv.job.interfaces import Interface
from hpcinv.mesh import Body
from hpcinv.mesh.parts import parts_of
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.topology import neighbour_signs
from hpcinv.model.interfaces.facets import Facets, RegionFacets, gathered

_SIGHT = 6.0
"""Distance, in mean radii of the facets, up to which facets of one body are searched for. Raised, the search takes
longer; lowered, load steps are cut before surfaces touch."""
_BEHIND = 2.0
"""Distance of the unloaded body's facets, in the sum of their radii, up to which one may be behind the other. Raised,
surfaces that were turned inside out do not meet; lowered, compressed walls press on themselves."""
_STEEP = 2.0
"""Lateral distance of facets behind each other, in their distance along the normal; lowered, sheared walls press on
themselves."""
_FLAT = 1e-3  # distance behind a facet, in radii, that counts as zero
_ORDER = np.sqrt([2.0, 3.0, 5.0])  # direction to which no plane of symmetry of a mesh is parallel


class OneBody:
    """Two surfaces that may belong to the same body, as they are on the unloaded body; not collective.

    Args:
        first, second: facets of all ranks of the unloaded body (scaled).
        parts: numbers of the connected parts of the mesh to which the facets of either surface belong.
        starts: number of the first one of this rank's facets among the facets of either surface.
        is_one_surface: whether both are the same surface, whose pairs of facets are each found twice.
    """

    def __init__(
        self, first: Facets, second: Facets, parts: tuple[Ints, Ints], starts: tuple[int, int], *, is_one_surface: bool
    ) -> None:
        self._first, self._second, self.is_one_surface = first, second, is_one_surface
        self._heights: Floats = np.round(first.middles[0] @ _ORDER, 9)
        self._signs = np.ones(len(first), dtype=np.int64)
        self._parts, self.starts = parts, starts
        self.radius = float(np.concatenate([first.radii, second.radii]).mean())
        """mean radius (scaled) of the facets"""
        self.sight = _SIGHT * self.radius
        """distance (scaled) up to which facets are searched for"""

    def may_meet(self, i: Ints, j: Ints) -> Booleans:
        """Return whether facets ``i`` of the first surface may press on facets ``j`` of the second one."""
        first, second = self._first, self._second
        shares = (first.nodes[i][:, :, None] == second.nodes[j][:, None]).any(axis=(1, 2))
        arms = second.middles[0][j] - first.middles[0][i]
        heights = np.einsum("ni,ni->n", arms, first.middles[1][i])
        sizes, distances = first.radii[i] + second.radii[j], np.linalg.norm(arms, axis=1)
        aside = np.sqrt(np.maximum(distances**2 - heights**2, 0.0))
        is_near = (distances <= _BEHIND * sizes) & (aside <= sizes + _STEEP * np.abs(heights))
        is_behind = (heights < -_FLAT * sizes) & is_near & (self._parts[0][i] == self._parts[1][j])
        meet: Booleans = ~(shares | is_behind)
        return meet

    def choose_sides(self, i: Ints, j: Ints) -> None:
        """Take pairs of facets ``i`` and ``j`` of one surface that face each other now; each facet is on one side.

        Sides alternate from facet to facing facet. Where that contradicts itself, as in a small cavity, the first one
        of a pair is the facet that was farther in a direction.
        """
        count = len(self._heights)
        signs, parts = neighbour_signs(i, j, np.full(len(i), -1), count)
        order = np.argsort(self._heights)
        farthest = np.zeros(int(parts.max(initial=0)) + 1, dtype=np.int64)
        farthest[parts[order]] = order  # the last one of each part, which does not depend on numbers
        self._signs = signs * signs[farthest[parts]]

    def are_chosen(self, i: Ints, j: Ints) -> Booleans:
        """Return which pairs of facets may meet, the first one on the first side."""
        chosen = self.may_meet(i, j)
        if self.is_one_surface:
            signs, heights = self._signs, self._heights
            chosen &= np.where(signs[i] == signs[j], heights[i] > heights[j], signs[i] > 0)
        return chosen


def one_body_of(where: str, spec: Interface, body: Body, surfaces: tuple[RegionFacets, RegionFacets]) -> OneBody | None:
    """Return two surfaces of the given mesh that belong to one body in part, else ``None``; collective.

    Args:
        where: place in the job.

    Raises:
        MeshError: on all ranks, if different regions have common facets.
    """
    comm, (_, labels) = body.mesh.comm, parts_of(body)
    first, second = (gathered(surface.at(body.given_nodes / body.length_scale), comm) for surface in surfaces)
    parts = [np.concatenate(comm.allgather(labels[surface.cells])) for surface in surfaces]
    if not np.intersect1d(parts[0], parts[1]).size:
        return None
    a, b = spec.between
    is_one_surface = a == b
    rows = [np.unique(np.sort(facets.nodes, axis=1), axis=0) for facets in (first, second)]
    common = len(rows[0]) + len(rows[1]) - len(np.unique(np.concatenate(rows), axis=0))
    if common and not is_one_surface:
        raise MeshError(
            f"{where}.between: '{a}' and '{b}' have {common} facets in common",
            f"Name surfaces without common facets, or one surface twice: [{a}, {a}].",
        )
    starts = comm.exscan(len(surfaces[0].cells)) or 0, comm.exscan(len(surfaces[1].cells)) or 0
    return OneBody(first, second, (parts[0], parts[1]), starts, is_one_surface=is_one_surface)
