"""Segments of two surfaces: where facets of one, seen along their normals, cover facets of the other.

Each facet of the first surface is projected to the plane through its middle, with the facets of the second one near it
and opposite to it. The overlap of two convex polygons is cut by half-planes (Sutherland & Hodgman, 1974,
doi:10.1145/360767.360802), and has Gauss points on triangles. So integrals over flat interfaces are exact, however the
two meshes lie, which quadrature points on the first mesh alone are not (Puso & Laursen, 2004,
doi:10.1016/j.cma.2003.10.010).
"""

from __future__ import annotations

from dataclasses import dataclass

import basix
import numpy as np

from hpcinv.base.quantity.arrays import Booleans
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.interfaces.facets import FacetKind, Facets
from hpcinv.model.interfaces.one_body import OneBody

OPPOSITE = -0.3
"""Cosine between outer normals of facets above which they do not face each other. Raised, edges of a surface meet
facets round the corner; lowered, strongly curved surfaces lose segments."""
_NEAR = 2.0
"""Radii of two facets, in addition to the distance of the nearest one, within which facets are tried. Raised, the
search takes longer; lowered, overlaps of very unequal facets are lost."""
_SLIVER = 1e-14
"""Share of a facet's area below which an overlap is left out; raised, integrals lose digits."""
_CONVERGED = 1e-12
_MOST = 30  # iterations of Newton's method for a point of a curved facet
_OUTSIDE = 0.05
"""Distance from a reference facet up to which points still belong to it: curved edges differ from their polygons."""
_OBLIQUE = 4
"""Degrees of quadrature that are added for quadrilaterals; lowered, oblique ones lose digits."""
_PAIRS = 20_000  # facets of the first surface that are searched together, for memory
_MORE = 16  # ratio of facets that are near to one of the same body


@dataclass(frozen=True)
class Segments:
    """Quadrature points on the overlap of two surfaces.

    Attributes:
        first, second: numbers of the facets, (n,).
        first_places, second_places: reference points on them, (n, 2).
        weights: area of the first surface, (n,), scaled.
        normals: unit normals of the first surface, out of its body, (n, 3).
        gaps: distance from the first to the second surface along the normal of the first facet, (n,); negative where
            they overlap.
        rigid_points: points (n, 3) of a rigid obstacle, scaled; 0 where the second surface has nodes.
    """

    first: Ints
    second: Ints
    first_places: Floats
    second_places: Floats
    weights: Floats
    normals: Floats
    gaps: Floats
    rigid_points: Floats

    @property
    def starts(self) -> Ints:
        """Numbers of the first points on each pair of facets; the other points of a pair follow them."""
        changes = (np.diff(self.first, prepend=-1) != 0) | (np.diff(self.second, prepend=-1) != 0)
        return np.flatnonzero(changes)


def segments(
    first: Facets, second: Facets, reach: float, *, share_nodes: bool = False, one_body: OneBody | None = None
) -> Segments:
    """Return the segments of facets that face each other; not collective.

    Args:
        reach: largest distance (scaled) of surfaces that face each other, and depth of an overlap. No overlap is deeper
            than two facets are wide: it would be the other side of a body.
        share_nodes: whether opposite facets may share nodes, as on the closed edge of an interface between labels.
        one_body: surfaces that belong to the same body.
    """
    size = _PAIRS if one_body is None else _PAIRS // _MORE
    parts = (
        [
            _segments(first, second, reach, np.arange(start, min(start + size, len(first))), share_nodes, one_body)
            for start in range(0, len(first), size)
        ]
        if len(second)
        else []
    )
    empty = Segments(
        *(np.zeros(0, dtype=np.int64),) * 2,
        *(np.zeros((0, 2)),) * 2,
        np.zeros(0),
        np.zeros((0, 3)),
        np.zeros(0),
        np.zeros((0, 3)),
    )
    fields = Segments.__dataclass_fields__
    return Segments(**{name: np.concatenate([getattr(part, name) for part in (empty, *parts)]) for name in fields})


def _segments(
    first: Facets, second: Facets, reach: float, chosen: Ints, share_nodes: bool, one_body: OneBody | None
) -> Segments:
    i, j = _candidates(first, second, reach, chosen, one_body)
    if one_body is not None:
        meet = one_body.are_chosen(i + one_body.starts[0], j)
        i, j = i[meet], j[meet]
    elif not share_nodes:
        apart = ~(first.nodes[i][:, :, None] == second.nodes[j][:, None]).any(axis=(1, 2))
        i, j = i[apart], j[apart]
    (origins, normals), tangents = first.middles[:, i], tangents_of(first.middles[1][i])
    polygons, counts = _overlaps(first, second, i, j, origins, tangents)
    corners, areas = _triangles(polygons, counts)
    sizes = np.pi * first.radii[i] ** 2
    kept = areas > _SLIVER * sizes[:, None]
    pair, _ = np.nonzero(kept)
    points, weights = basix.make_quadrature(basix.CellType.triangle, _quadrature_degree(first.kind, second.kind))
    hats = np.column_stack([1 - points.sum(axis=1), points])
    places = np.einsum("qv,tvi->tqi", hats, corners[kept]).reshape(-1, 2)
    plane_weights = (2 * areas[kept][:, None] * weights).ravel()
    pair = np.repeat(pair, len(points))
    i, j, origins, normals, tangents = i[pair], j[pair], origins[pair], normals[pair], tangents[pair]
    here, x, slopes, is_here = seen_points(first, i, origins, tangents, places)
    there, y, _, is_there = seen_points(second, j, origins, tangents, places)
    area = np.cross(slopes[0], slopes[1]) * first.signs[i, None]
    size = np.linalg.norm(area, axis=1)
    outer = area / np.where(size > 0, size, 1.0)[:, None]
    slant = np.einsum("ni,ni->n", outer, normals)
    gaps = np.einsum("ni,ni->n", y - x, normals)
    depth = np.minimum(first.radii[i] + second.radii[j], reach)
    good = is_here & is_there & (slant > 0) & (gaps <= reach) & (gaps >= -depth)
    weights = plane_weights / np.where(good, slant, 1.0)
    rigid = np.zeros((int(good.sum()), 3))
    return Segments(i[good], j[good], here[good], there[good], weights[good], outer[good], gaps[good], rigid)


def facing_pairs(facets: Facets, reach: float, one_body: OneBody) -> tuple[Ints, Ints]:
    """Return pairs of facets of one surface, all on this rank, that are near, face each other and may meet."""
    size = _PAIRS // _MORE
    starts = range(0, len(facets), size)
    found = [
        _candidates(facets, facets, reach, np.arange(start, min(start + size, len(facets))), one_body)
        for start in starts
    ]
    i, j = (np.concatenate([np.zeros(0, dtype=np.int64), *part]) for part in zip(*found, strict=True))
    meet = one_body.may_meet(i, j)
    return i[meet], j[meet]


def _quadrature_degree(first: FacetKind, second: FacetKind) -> int:
    """Return the degree of products of two basis functions; on oblique quadrilaterals these are not polynomials."""
    degree = max(first.degree, second.degree)
    return 2 * degree if first.corner_count == second.corner_count == 3 else 4 * degree + _OBLIQUE


def _candidates(
    first: Facets, second: Facets, reach: float, chosen: Ints, one_body: OneBody | None
) -> tuple[Ints, Ints]:
    """Return pairs of facets that are near and opposite to each other."""
    from scipy.spatial import cKDTree  # which runs without interfaces do not load

    tree = cKDTree(second.middles[0])
    largest = float(second.radii.max(initial=0.0))
    if one_body is None:
        nearest, _ = tree.query(first.middles[0][chosen])
    else:  # the nearest one is a neighbour
        nearest = np.full(len(chosen), one_body.sight)
    radii = np.minimum(nearest, reach) + _NEAR * (first.radii[chosen] + largest)
    found = tree.query_ball_point(first.middles[0][chosen], radii)
    lengths = np.array([len(near) for near in found], dtype=np.int64)
    i = np.repeat(chosen, lengths)
    j = np.concatenate([np.zeros(0, dtype=np.int64), *(np.asarray(near, dtype=np.int64) for near in found)])
    faces = np.einsum("ni,ni->n", first.middles[1][i], second.middles[1][j]) < OPPOSITE
    arms = second.middles[0][j] - first.middles[0][i]
    depths = np.einsum("ni,ni->n", arms, first.middles[1][i])
    aside = np.sqrt(np.maximum((arms**2).sum(axis=1) - depths**2, 0.0))
    covers = aside <= 1.01 * (first.radii[i] + second.radii[j])
    kept = faces & covers
    return i[kept], j[kept]


def tangents_of(normals: Floats) -> Floats:
    """Return two unit vectors in the plane of each normal, (n, 2, 3), right-handed with it."""
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    one = np.cross(normals, axis)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    return np.stack([one, np.cross(normals, one)], axis=1)


def _overlaps(
    first: Facets, second: Facets, i: Ints, j: Ints, origins: Floats, tangents: Floats
) -> tuple[Floats, Ints]:
    """Return the overlap of each pair in its plane as polygons (n, most, 2), and their numbers of vertices."""

    def outline(facets: Facets, chosen: Ints) -> Floats:
        points = facets.points[chosen][:, _corners(facets.kind)]
        return np.asarray(np.einsum("nki,nti->nkt", points - origins[:, None], tangents))

    subject, window = outline(second, j), _turned_left(outline(first, i))
    polygon, count = subject, np.full(len(subject), subject.shape[1])
    for edge in range(window.shape[1]):
        a, b = window[:, edge], window[:, (edge + 1) % window.shape[1]]
        polygon, count = _cut(polygon, count, a, b)
    return polygon, count


def _corners(kind: FacetKind) -> list[int]:
    return [0, 1, 2] if kind.corner_count == 3 else [0, 1, 3, 2]


def _turned_left(polygons: Floats) -> Floats:
    turned = np.roll(polygons, -1, axis=1)
    area = (polygons[..., 0] * turned[..., 1] - polygons[..., 1] * turned[..., 0]).sum(axis=1)
    return np.asarray(np.where((area < 0)[:, None, None], polygons[:, ::-1], polygons), dtype=np.float64)


def _cut(polygons: Floats, counts: Ints, a: Floats, b: Floats) -> tuple[Floats, Ints]:
    """Return the parts of convex polygons to the left of lines from ``a`` to ``b``."""
    n, most = polygons.shape[:2]
    places = np.arange(most)
    exists = places < counts[:, None]
    following = np.where(places + 1 < counts[:, None], places + 1, 0)
    edge = b - a
    arms = polygons - a[:, None]
    heights = edge[:, None, 0] * arms[..., 1] - edge[:, None, 1] * arms[..., 0]
    inside = (heights >= 0) & exists
    next_heights = np.take_along_axis(heights, following, axis=1)
    next_points = np.take_along_axis(polygons, following[:, :, None], axis=1)
    crosses = ((heights >= 0) != (next_heights >= 0)) & exists
    span = np.where(crosses, heights - next_heights, 1.0)
    cuts = polygons + (heights / span)[:, :, None] * (next_points - polygons)
    points = np.stack([polygons, cuts], axis=2).reshape(n, 2 * most, 2)
    kept = np.stack([inside, crosses], axis=2).reshape(n, 2 * most)
    order = np.argsort(~kept, axis=1, kind="stable")[:, : most + 1]
    # Rounding errors of edges that coincide may cross a line more than twice; vertices beyond that add no area.
    return np.take_along_axis(points, order[:, :, None], axis=1), np.minimum(kept.sum(axis=1), most + 1)


def _triangles(polygons: Floats, counts: Ints) -> tuple[Floats, Floats]:
    """Return triangles (n, most - 2, 3, 2) from the first vertex of convex polygons, and areas, 0 without one."""
    most = polygons.shape[1]
    second, third = polygons[:, 1 : most - 1], polygons[:, 2:most]
    first = np.broadcast_to(polygons[:, :1], second.shape)
    triangles = np.stack([first, second, third], axis=2)
    one, other = second - first, third - first
    areas = np.abs(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]) / 2
    return triangles, np.where(np.arange(2, most) < counts[:, None], areas, 0.0)


def _combined(values: Floats, nodes: Floats) -> Floats:
    """Return values (d, n, k) times nodes (n, k, 3), as (d, n, 3)."""
    product: Floats = np.matmul(values.transpose(1, 0, 2), nodes).transpose(1, 0, 2)
    return product


def seen_points(
    facets: Facets, chosen: Ints, origins: Floats, tangents: Floats, places: Floats
) -> tuple[Floats, Floats, Floats, Booleans]:
    """Return the reference points of facets that are seen at places (n, 2) of planes, by Newton's method.

    Returns:
        Reference points (n, 2), points (n, 3), their derivatives (2, n, 3), and whether they were found on the facets.
    """
    kind, nodes = facets.kind, facets.points[chosen]
    reference = np.repeat(kind.middle, len(chosen), axis=0)
    size = facets.radii[chosen]
    for _ in range(_MOST):
        values = kind.values(reference)
        x, *slopes = _combined(values, nodes)
        missing = places - np.einsum("ni,nti->nt", x - origins, tangents)
        jacobian = np.einsum("dni,nti->ntd", np.array(slopes), tangents)
        determinant = jacobian[:, 0, 0] * jacobian[:, 1, 1] - jacobian[:, 0, 1] * jacobian[:, 1, 0]
        safe = np.where(determinant != 0, determinant, 1.0)
        step = np.stack(
            [
                (jacobian[:, 1, 1] * missing[:, 0] - jacobian[:, 0, 1] * missing[:, 1]) / safe,
                (jacobian[:, 0, 0] * missing[:, 1] - jacobian[:, 1, 0] * missing[:, 0]) / safe,
            ],
            axis=1,
        )
        reference = reference + np.clip(step, -1.0, 1.0)
        if not len(step) or np.abs(step).max() <= _CONVERGED:
            break
    values = kind.values(reference)
    x, *slopes = _combined(values, nodes)
    missing = places - np.einsum("ni,nti->nt", x - origins, tangents)
    beyond = np.maximum(-reference.min(axis=1), reference.max(axis=1) - 1)
    if kind.corner_count == 3:
        beyond = np.maximum(beyond, reference.sum(axis=1) - 1)
    found = (np.linalg.norm(missing, axis=1) <= 1e-9 * size) & (beyond <= _OUTSIDE)
    return reference, x, np.array(slopes), found
