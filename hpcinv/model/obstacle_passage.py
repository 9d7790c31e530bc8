"""Ways of a body's surface past rigid obstacles: a step must not carry a point from one side of an obstacle to another.

The gap at the end of a step says nothing about its way: a point that has passed through a peg is free again. The
straight way of each point, relative to the obstacle, is therefore followed as far as it is near: a signed distance is
the length that no obstacle obstructs (sphere tracing, Hart 1996, doi:10.1007/s003710050084). A way has passed through
if it has been inside of the obstacle and the direction out of it has turned.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import basix
import numpy as np

from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh import Body
from hpcinv.mesh.boundary_shells import cells_and_sides
from hpcinv.mesh.cells import scalar_element, sub_entities
from hpcinv.mesh.source import Floats
from hpcinv.model.spaces import Unknowns

type DistanceFunction = Callable[[Floats], tuple[Floats, Floats]]
"""Signed distances (n,) of points (n, 3), and the directions (n, 3) out of the obstacle."""

_FINEST = 2.0**-16
"""Depth in lengths of the body up to which a passage counts as rounding; shortest step along a way. If it is raised,
thinner obstacles are passed unnoticed."""
_DEEP = 2.0**-8
"""Depth in lengths of the body from which a point that cuts a corner of the obstacle has passed through it. If it is
raised, points slide round an obstacle in fewer steps, and cut off more of it."""
_TURNED = -0.25
"""Cosine between the directions at entry and exit below which the sides differ, so that right angles are one edge."""
_TURNED_DEEP = 0.5
"""Cosine as above, for deep ways."""
_TOUCH = 0.1
"""Share of the way between entry and turn where a point is left: it must press there. If it is raised, points go in and
out of contact for more iterations; if it is lowered, more iterations end at the obstacle."""
_MOST = 128
"""Steps along one way; the shortest one doubles after each 8. If it is lowered, ways along a surface are not
followed to their end."""
_DIVISIONS = 8
"""Parts of an edge of a facet, between points that are followed, for an obstacle without a known thickness; at least 2
are taken for others. If it is raised, thinner obstacles are seen, and each iteration takes longer."""
_POINTS = 50_000
"""Largest number of points of a rank, about 0.01 s for each time that they are moved. If it is lowered, thin obstacles
are passed unnoticed by large facets."""


class SurfacePoints:
    """Points on the facets of a region, no farther apart than the obstacle needs.

    Args:
        size: half of the obstacle's thickness (scaled), ``None`` if it is not known.
    """

    def __init__(self, body: Body, facets: LocalIndices, unknowns: Unknowns, size: float | None) -> None:
        mesh, kind = body.mesh, body.source.kind
        self._mesh, self._unknowns = mesh, unknowns
        cells, sides = cells_and_sides(mesh, facets)
        corners, places = sub_entities(kind, 2), basix.geometry(basix.CellType[kind])
        geometry = scalar_element(kind, body.degree)
        shape = unknowns.scalar_elements[0]
        corner_shapes = geometry.tabulate(0, places)[0, :, :, 0]
        self._parts = []
        for side in np.unique(sides):
            own = cells[sides == side]
            nodes = mesh.geometry.dofmaps[0][own]
            vertices = np.einsum("vi,cij->cvj", corner_shapes[corners[side]], mesh.geometry.x[nodes])
            longest = float(np.linalg.norm(vertices - np.roll(vertices, 1, axis=1), axis=2).max(initial=0.0))
            wanted = _DIVISIONS if size is None else math.ceil(min(2 * longest / size, _POINTS))
            points = _lattice(places[corners[side]], max(min(wanted, math.isqrt(_POINTS // len(cells))), 2))
            dofs = unknowns.displacement_space.dofmap.list[own]
            self._parts.append((nodes, geometry.tabulate(0, points)[0, :, :, 0], dofs, shape.tabulate(0, points)[0]))

    def places(self) -> Floats:
        """Return the points (n, 3) on the mesh."""
        x = self._mesh.geometry.x
        return _stacked([table @ x[nodes] for nodes, table, _, _ in self._parts])

    def displacements(self) -> Floats:
        """Return their present displacements (n, 3)."""
        u = self._unknowns.displacement().x.array.reshape(-1, 3)
        return _stacked([table @ u[dofs] for _, _, dofs, table in self._parts])


def _stacked(parts: Sequence[Floats]) -> Floats:
    return np.concatenate([np.zeros((0, 3)), *(part.reshape(-1, 3) for part in parts)])


def _lattice(corners: Floats, n: int) -> Floats:
    """Return points on a triangle or a quadrilateral of a reference cell, with its corners, ``n`` parts to an edge."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    is_inside = i + j <= n if len(corners) == 3 else np.ones_like(i, dtype=bool)
    first_share, second_share = i[is_inside] / n, j[is_inside] / n
    return np.asarray(
        corners[0] + np.outer(first_share, corners[1] - corners[0]) + np.outer(second_share, corners[2] - corners[0])
    )


@dataclass(frozen=True)
class _Position:
    """Points relative to an obstacle, and the nodes of the mesh that they are made of."""

    points: Floats
    places: Floats


class Passage:
    """The ways of one region past one obstacle; not collective.

    Args:
        bounds: least and largest coordinates of the obstacle, (3,) each.
        shift: returns the present displacement (3,) of the obstacle.
    """

    def __init__(
        self,
        points: SurfacePoints,
        distance: DistanceFunction,
        bounds: tuple[Floats, Floats],
        shift: Callable[[], Floats],
    ) -> None:
        self._points, self._distance, self._bounds, self._shift = points, distance, bounds, shift
        self._start: _Position | None = None

    def depart(self) -> None:
        """Let ways begin at the present state."""
        self._start = self._position()

    def forget(self) -> None:
        """Let ways begin at the next state that `has_passed` sees."""
        self._start = None

    def has_passed(self) -> bool:
        """Return whether the way from the start to the present state leads through the obstacle."""
        here = self._position()
        if self._start is None or not np.array_equal(self._start.places, here.places):
            self.depart()
            return False
        return bool(np.isfinite(self._passes(self._start.points, here.points)).any())

    def points(self) -> Floats:
        """Return the present points, relative to the obstacle."""
        return self._position().points

    def share(self, start: Floats, end: Floats) -> float:
        """Return the share of a way up to where the first passage begins, 1 without one."""
        return float(self._passes(start, end).min(initial=1.0))

    def _position(self) -> _Position:
        places = self._points.places()
        return _Position(places + self._points.displacements() - self._shift(), places)

    def _passes(self, start: Floats, end: Floats) -> Floats:
        """Return for each point the share of its way up to where a passage begins, infinite without one."""
        shares, (low, high) = np.full(len(start), np.inf), self._bounds
        is_near = ((np.maximum(start, end) >= low) & (np.minimum(start, end) <= high) & np.isfinite(end)).all(axis=1)
        is_near &= (start != end).any(axis=1)
        shares[is_near] = passages(self._distance, start[is_near], end[is_near])
        return shares


def passages(distance: DistanceFunction, start: Floats, end: Floats) -> Floats:
    """Return the share of each straight way just beyond its entry into an obstacle that it passes through.

    It is infinite for a way that does not pass through the obstacle.
    """
    count, shares = len(start), np.full(len(start), np.inf)
    lengths = np.linalg.norm(end - start, axis=1)
    position, entry, depth = np.zeros(count), np.full(count, np.nan), np.zeros(count)
    direction, last_position = np.zeros((count, 3)), np.zeros(count)
    active = np.arange(count)
    for number in range(_MOST):
        if not len(active):
            break
        t = position[active]
        points = start[active] + t[:, None] * (end - start)[active]
        gap, normal = distance(points)
        is_new = np.isnan(entry[active]) & (gap <= 0)
        entry[active[is_new]], direction[active[is_new]] = t[is_new], normal[is_new]
        is_inside = ~np.isnan(entry[active])
        depth[active] = np.maximum(depth[active], np.where(is_inside, -gap, 0.0))
        cosine = np.einsum("ni,ni->n", normal, direction[active])
        limit = np.where(depth[active] > _DEEP, _TURNED_DEEP, _TURNED)
        has_turned = is_inside & (depth[active] > _FINEST) & (cosine < limit)
        turned = active[has_turned]
        turn = (last_position[turned] + position[turned]) / 2
        shares[turned] = entry[turned] + _TOUCH * (turn - entry[turned])
        has_left = is_inside & (gap > 0) & ~has_turned
        entry[active[has_left]], depth[active[has_left]] = np.nan, 0.0
        shortest = _FINEST * 2.0 ** (number // 8)
        # Inside, a step is at most twice as long as the way in so far: the depth of a formula is not its distance.
        step = np.where(is_inside & ~has_left, np.minimum(np.abs(gap), (t - entry[active]) * lengths[active]), gap)
        last_position[active] = t
        position[active] = t + np.maximum(step, shortest) / lengths[active]
        is_last = (t >= 1) | (~is_inside & (gap > (1 - t) * lengths[active]))
        position[active] = np.minimum(position[active], 1.0)
        active = active[~(has_turned | is_last)]
    return shares
