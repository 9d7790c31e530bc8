"""Cells of second degree whose nodes lie on smooth boundaries, as far as the shape of the cells allows it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import product
from math import factorial
from typing import Protocol

import numpy as np

from hpcinv.base.quantity.units import readable
from hpcinv.geometry.imaging.label_boundary import growth, held_back, limit_steps, shift, two_label_nodes
from hpcinv.geometry.imaging.lattice import Lattice
from hpcinv.mesh.cells import jacobians, scalar_element, sub_entities
from hpcinv.mesh.checks import det
from hpcinv.mesh.crossing_facets import find_overlap
from hpcinv.mesh.refine.degree import inner_dofs, raised
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.mesh.surface import surface_of

_ROUNDS = 6
_KEPT = 0.5  # share of a straight cell's determinant that the curved cell keeps everywhere
_HALVINGS = 5  # of the way of a node; then it stays in the middle of its edge
_AT_ONCE = 20_000  # cells
_CUBIC = 3  # degree of the determinant in tetrahedra of second degree


class SmoothBoundary(Protocol):
    """A smooth boundary between labels."""

    def nearest(self, points: Floats, lower: Ints, upper: Ints, reach: float) -> tuple[Floats, Floats]:
        """Points (n, 3) of the boundary between two labels near to the given ones, at most ``reach`` (m) away, and unit
        normals (n, 3) from label ``upper`` into ``lower``."""


def curved(
    source: MeshSource,
    labels: Ints,
    pairs: Ints,
    boundary: SmoothBoundary,
    spacing: float,
    volumes: Sequence[float],
    least: float,
    report: Callable[[str], None],
) -> tuple[MeshSource, list[float]]:
    """Return the mesh with cells of second degree, nodes of facets between labels on smooth boundaries, and the
    relative errors of the volumes of labels, which are kept.

    The way of a node between two vertices is halved as long as a cell would have less than half of its straight
    determinant somewhere; where facets would cross, they are straight.

    Args:
        source: straight tetrahedra of positive volume.
        labels: of its cells, (m,).
        pairs: labels on both sides of its facets, (f, 2), the smaller one first.
        spacing: of the lattice that the cells were made from (m).
        volumes: of the labels (m³), of the n-th at n - 1.
        least: scaled Jacobian below which straight cells do not become worse.
        report: called with the number of nodes that were held back.
    """
    mesh, count, reach = raised(source), len(volumes) + 1, 0.6 * spacing
    straight = Lattice(source.points, source.cells, labels)
    nodes, lower, upper = two_label_nodes(mesh.facets, pairs, len(mesh.points), count)
    is_middle = nodes >= len(source.points)
    ends = edge_nodes(mesh)
    points = mesh.points.copy()
    normals = np.zeros_like(points)
    for some in (~is_middle, is_middle):  # middles from between the vertices on the boundary
        points[ends[:, 0]] = points[ends[:, 1:]].mean(axis=1)
        chosen = nodes[some]
        points[chosen], normals[chosen] = boundary.nearest(points[chosen], lower[some], upper[some], reach)
    target, outward, share = points, np.zeros(count), np.ones(len(points))
    vertices, middles = nodes[~is_middle], nodes[is_middle]
    for turn in range(_ROUNDS):
        end = target.copy()
        end[nodes] += shift(outward, lower, upper)[:, None] * normals[nodes]
        end[vertices] = limit_steps(mesh.points[vertices], end[vertices], reach)
        placed, went = held_back(straight, vertices, end[: len(source.points)], least)
        points = np.concatenate([placed, np.zeros((len(ends), 3))])
        points[ends[:, 0]] = points[ends[:, 1:]].mean(axis=1)
        bend = np.zeros_like(points)
        bend[middles] = end[middles] - points[middles]
        share = shares_of_bend(mesh.cells, points, bend, share)
        if turn == _ROUNDS - 1:
            share = _uncrossed(mesh, points, bend, share)
        points += share[:, None] * bend
        label_volumes = _volumes(mesh.cells, points, labels, count)
        outward += growth(np.array(volumes) - label_volumes, points, source.facets, pairs, 0.25 * spacing)
    bent = np.linalg.norm(share[:, None] * bend, axis=1)
    stopped = np.count_nonzero((share < 1) & bend.any(axis=1)) + np.count_nonzero(went[vertices] < 1)
    report(
        f"cells of second degree: {len(middles):,} nodes between vertices on the smooth boundary, up to"
        f" {readable(float(bent.max(initial=0.0)), 'm')} from straight edges; {stopped:,} held back for the shape of"
        " cells"
    )
    return replace(mesh, points=points), (label_volumes / np.array(volumes) - 1).tolist()


def edge_nodes(mesh: MeshSource) -> Ints:
    """Middle and both vertices of each edge, (edges, 3)."""
    middles = mesh.cells[:, inner_dofs(mesh.kind, 1)].reshape(-1, 1)
    edges = mesh.cells[:, sub_entities(mesh.kind, 1)].reshape(-1, 2)
    _, first = np.unique(middles, return_index=True)
    return np.concatenate([middles, edges], axis=1)[first]


def shares_of_bend(cells: Ints, points: Floats, bend: Floats, share: Floats) -> Floats:
    """Share of their way ``bend`` (n, 3) that nodes between vertices can go from straight edges."""
    share, going = share.copy(), np.flatnonzero(bend.any(axis=1))
    bent = cells[np.isin(cells, going).any(axis=1)]
    for turn in range(1, _HALVINGS + 1):
        least = _determinants(bent, points + share[:, None] * bend).min(axis=1)
        bad = least < _KEPT * _determinants(bent, points)[:, 0]
        if not bad.any():
            break
        changed = np.unique(bent[bad])
        share[changed] *= 0.5 if turn < _HALVINGS else 0.0
        bent = bent[np.isin(bent, changed).any(axis=1)]
    return share


def _uncrossed(mesh: MeshSource, points: Floats, bend: Floats, share: Floats) -> Floats:
    """The shares with 0 at nodes of facets that would cross."""
    share = share.copy()
    for _ in range(_ROUNDS):
        surface = surface_of(replace(mesh, points=points + share[:, None] * bend))
        crossing = surface.tags[list(find_overlap(surface).facets)]
        if not share[crossing].any():
            break
        share[crossing] = 0.0
    return share


def _volumes(cells: Ints, points: Floats, labels: Ints, count: int) -> Floats:
    """Volumes of labels from 1 in cells of second degree."""
    each = _determinants(cells, points).mean(axis=1) / 6
    return np.asarray(np.bincount(labels, each, minlength=count)[1:], dtype=np.float64)


def _determinants(cells: Ints, points: Floats) -> Floats:
    """Coefficients (n, 20) of det J of cells in the Bernstein basis; the least and the largest of them bound it.

    Source: Johnen, Remacle, Geuzaine, "Geometrical validity of curvilinear finite elements" (2013),
    doi:10.1016/j.jcp.2012.08.051.
    """
    nodes = scalar_element("tetrahedron", _CUBIC).points
    coefficients = np.empty((len(cells), len(nodes)))
    for begin in range(0, len(cells), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        coefficients[part] = det(jacobians("tetrahedron", 2, points[cells[part]], nodes)) @ _bernstein_matrix().T
    return coefficients


@cache
def _bernstein_matrix() -> Floats:
    """Coefficients of a cubic in a tetrahedron in the Bernstein basis from its values at the cubic element's nodes."""
    nodes = scalar_element("tetrahedron", _CUBIC).points
    weights = np.column_stack([1 - nodes.sum(axis=1), nodes])
    powers = np.array([p for p in product(range(_CUBIC + 1), repeat=4) if sum(p) == _CUBIC])
    times = [factorial(_CUBIC) / np.prod([factorial(i) for i in p]) for p in powers]
    values = (weights[:, None, :] ** powers).prod(axis=2) * times
    return np.asarray(np.linalg.inv(values))
