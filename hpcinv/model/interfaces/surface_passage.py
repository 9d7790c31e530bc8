"""Ways of two surfaces of one mesh: a step must not carry a node of one through the other.

Contact acts where surfaces face each other. A step that carries a body through another one, or deep into it, ends where
none do, and nothing presses. So each node that has moved far is followed on its straight way through the facets of the
other surface, which move straight, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import Booleans
from hpcinv.mesh import Body
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.interfaces.facets import Facets, RegionFacets, gathered
from hpcinv.model.interfaces.one_body import OneBody
from hpcinv.model.spaces import Unknowns

_DEEP = 2.0**-6
"""Smallest depth, in lengths of the body, of a node that has passed through. Lowered, steps are cut where surfaces
press hard; raised, thinner bodies are passed unnoticed."""
type Rule = Callable[[Ints, Ints], Booleans]
"""whether nodes of facets may meet other facets"""
_AT_ONCE = 1 << 20  # pairs of node and triangle, for memory


@dataclass(frozen=True)
class _Place:
    """Both surfaces on this rank and on all ranks, and the nodes of the mesh on which they are."""

    mine: tuple[Facets, Facets]
    all_facets: tuple[Facets, Facets]
    mesh_nodes: Floats


class SurfacePassage:
    """The ways of both surfaces of an interface; methods are collective.

    Args:
        one_body: surfaces that belong to the same body; its nodes are found again up to a radius of the facets.
    """

    def __init__(
        self,
        surfaces: tuple[RegionFacets, RegionFacets],
        body: Body,
        unknowns: Unknowns,
        one_body: OneBody | None = None,
    ) -> None:
        self._surfaces, self._body, self._unknowns = surfaces, body, unknowns
        self._comm, self._depth = body.mesh.comm, _DEEP * body.length
        self._rules: tuple[Rule | None, Rule | None] = (None, None)
        if one_body is not None:
            self._depth = min(self._depth, one_body.radius)
            starts, may_meet = one_body.starts, one_body.may_meet
            self._rules = (lambda i, j: may_meet(i + starts[0], j), lambda i, j: may_meet(j, i + starts[1]))
        self._start: _Place | None = None

    def depart(self) -> None:
        """Let ways begin at the present state."""
        self._start = self._place()

    def forget(self) -> None:
        """Let ways begin at the next state that `has_passed` sees."""
        self._start = None

    def has_passed(self) -> bool:
        """Return whether a node of this rank has passed through the other surface since the start."""
        start, here = self._start, self._place()
        is_same = start is not None and np.array_equal(start.mesh_nodes, here.mesh_nodes)
        if start is None or not self._comm.allreduce(is_same, op=MPI.LAND):
            self._start = here
            return False
        ways = [(start.mine[k].points, here.mine[k].points) for k in (0, 1)]
        facets = [(start.all_facets[k], here.all_facets[k]) for k in (0, 1)]
        return any(_passes(*ways[k], *facets[1 - k], self._depth, self._rules[k]) for k in (0, 1))

    def points(self) -> Floats:
        """Return no points: surfaces are followed from one solve to the next, not within a solve."""
        return np.zeros((0, 3))

    def share(self, start: Floats, end: Floats) -> float:
        """Return 1: no iteration is shortened."""
        return 1.0

    def _place(self) -> _Place:
        x, unknowns = self._body.mesh.geometry.x, self._unknowns
        u = unknowns.state.x.array[unknowns.displacement_dofs_of_nodes]
        first, second = (surface.at(x, u) for surface in self._surfaces)
        return _Place((first, second), (gathered(first, self._comm), gathered(second, self._comm)), x.copy())


def _passes(start: Floats, end: Floats, before: Facets, after: Facets, depth: float, rule: Rule | None = None) -> bool:
    """Return whether a node (facets, nodes, 3) gets deeper than a depth through facets that move."""
    per_facet = start.shape[1]
    start, end = start.reshape(-1, 3), end.reshape(-1, 3)
    old, new = _triangles(before), _triangles(after)
    if not len(old):
        return False
    moved = np.linalg.norm(end - start, axis=1) + np.linalg.norm(new - old, axis=2).max()
    both = np.concatenate([old, new])
    low, high = both.min(axis=(0, 1)), both.max(axis=(0, 1))
    near = (np.maximum(start, end) >= low).all(axis=1) & (np.minimum(start, end) <= high).all(axis=1)
    chosen = np.flatnonzero((moved > depth) & near & np.isfinite(end).all(axis=1))
    step = max(_AT_ONCE // len(old), 1)
    parts = (chosen[i : i + step] for i in range(0, len(chosen), step))
    for part in parts:
        i, j = _crossed(start[part], end[part], old, new, depth)
        if len(i) and (rule is None or rule(part[i] // per_facet, j % len(before)).any()):
            return True
    return False


def _triangles(facets: Facets) -> Floats:
    """Return the corners (n, 3, 3) of triangles of facets, anticlockwise if they are seen from outside."""
    splits = [[0, 1, 2]] if facets.kind.corner_count == 3 else [[0, 1, 2], [1, 3, 2]]
    corners = np.concatenate([facets.points[:, split] for split in splits])
    is_inward = np.tile(facets.signs < 0, len(splits))
    corners[is_inward] = corners[is_inward][:, [0, 2, 1]]
    return corners


def _crossed(start: Floats, end: Floats, old: Floats, new: Floats, depth: float) -> tuple[Ints, Ints]:
    """Return the ways that lead from the outer side of triangles through them, deeper than a depth, and these."""
    outside, inside = _heights(start, old), _heights(end, new)
    i, j = np.nonzero((outside > -depth) & (inside < -depth))
    above = np.maximum(outside[i, j], 0.0)
    share = (above / (above - inside[i, j]))[:, None]
    point = start[i] + share * (end - start)[i]
    a, b, c = np.moveaxis(old[j] + share[:, None] * (new - old)[j], 1, 0)
    normal = np.cross(b - a, c - a)
    sides = [np.einsum("ni,ni->n", np.cross(q - p, point - p), normal) for p, q in ((a, b), (b, c), (c, a))]
    crosses = np.min(sides, axis=0) >= 0
    return i[crosses], j[crosses]


def _heights(points: Floats, triangles: Floats) -> Floats:
    """Return the heights (n, m) of points above the planes of triangles, outwards."""
    a = triangles[:, 0]
    normals = np.cross(triangles[:, 1] - a, triangles[:, 2] - a)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(points @ normals.T - np.einsum("mi,mi->m", a, normals))
