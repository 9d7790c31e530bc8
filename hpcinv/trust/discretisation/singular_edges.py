"""Edges at which the stress of a body has no bound, found by its shape and its supports: re-entrant ones, and those at
which a support ends.

There the displacement is ``u ~ r^λ`` with λ below 1 (`hpcinv.trust.discretisation.wedge_exponents`), which no degree of
elements resolves: errors of quantities fall as ``h^2λ`` only, in cells that touch the edge. Singular points of a fibre
field are added to them (`hpcinv.trust.discretisation.singular_fibres`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import dolfinx
import numpy as np

from hpcinv.base.parallel.runtime import on_root
from hpcinv.job.job import Job
from hpcinv.job.vocabulary import AXES
from hpcinv.mesh import Body
from hpcinv.mesh.boundary_shells import outer_facets
from hpcinv.mesh.cells import FACET_KIND, kind_and_degree, sub_entities
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.topology import unique_rows
from hpcinv.trust.discretisation.singular_fibres import singular_fibres
from hpcinv.trust.discretisation.wedge_exponents import SMOOTH, Hold, axial_exponent, plane_exponent

CURVED = math.radians(60)  # rad: a re-entrant edge up to which facets may be a curved surface's
LEAST = math.radians(30)  # rad: below it they always are
SHARPER = 2.0  # least ratio of an edge's angle to its neighbours'; larger takes more edges for a curved surface
LIMITING = 0.95  # exponents above it hardly limit anything, and are left out
FIBRES = "singular fibres"
_NORMAL = 8  # bit of the normal, after three of the axes
SCALE_FREE = 0.999
"""Exponent of singular fibres: 1, but below `SMOOTH`, since no degree resolves them. Lower: they refine more."""
KAPPA = {True: 1.0, False: 1.8}  # 3 - 4ν, of (nearly) incompressible material, and of Poisson's ratio 0.3


@dataclass(frozen=True)
class SingularEdges:
    """Singular edges of a body at its cells of this rank.

    Attributes:
        exponents: least λ at the vertices of each owned cell, `SMOOTH` of cells that touch no edge.
        kinds: number in ``names`` of the edge of that exponent, for each owned cell; -1 for none.
        names: what these edges are; `FIBRES` for a point at which a fibre field has no limit.
        segments: ends (edges, 2, 3) of all of them in m, the same on all ranks; short ones at points of fibres.
        segment_exponents: their exponents (edges,).
    """

    exponents: Floats
    kinds: Ints
    names: Sequence[str]
    segments: Floats
    segment_exponents: Floats


def singular_edges(job: Job, body: Body, configurations: Mapping[str, Floats] | None = None) -> SingularEdges | None:
    """Find the singular edges of a job's body on the given mesh; collective.

    Args:
        configurations: local geometry nodes (m) of those on which fibres are given; default: the given mesh.
    """
    with body.at(body.given_nodes):
        return _singular_edges(job, body, configurations or dict.fromkeys(("reference", "current"), body.given_nodes))


def _singular_edges(job: Job, body: Body, configurations: Mapping[str, Floats]) -> SingularEdges | None:
    mesh = body.mesh
    exterior = dolfinx.mesh.exterior_facet_indices(mesh.topology).astype(np.int32)
    if not job.mesh.kind.has_singular_edges:
        exterior = exterior[:0]
    nodes, areas = outer_facets(mesh, exterior)
    held = np.zeros((len(exterior), len(job.supports)), dtype=np.int64)
    for number, support in enumerate(job.supports):
        axes = sum(1 << axis for axis, name in enumerate(AXES) if name in support.held) + support.slides * _NORMAL
        held[np.isin(exterior, body.held_facets(support.region)), number] = axes
    numbers = mesh.geometry.index_map().local_to_global(nodes.ravel()).reshape(nodes.shape)
    gathered = mesh.comm.gather((numbers, mesh.geometry.x[nodes], areas, held))
    kind, _ = kind_and_degree(mesh)

    def find_on_root() -> _SingularEdges:
        assert gathered is not None
        numbers, corners, areas, held = (np.concatenate(part) for part in zip(*gathered, strict=True))
        regions = [support.region for support in job.supports]
        return _edges(FACET_KIND[kind], numbers, corners, areas, held, regions, KAPPA[job.pressure_degree is not None])

    edges = on_root(mesh.comm, find_on_root)
    singular = _with_fibres(_cell_edges(body, edges), *singular_fibres(job, body, configurations), body)
    return singular if len(singular.segments) else None


def _with_fibres(edges: SingularEdges, cells: Ints, points: Floats, body: Body) -> SingularEdges:
    """Return the edges with the singular points of fibres in some owned cells; collective."""
    gathered = np.concatenate(body.mesh.comm.allgather(points))
    if not len(gathered):
        return edges
    exponents, kinds = edges.exponents.copy(), edges.kinds.copy()
    smooth = cells[exponents[cells] > SCALE_FREE]
    exponents[smooth], kinds[smooth] = SCALE_FREE, len(edges.names)
    half = 1e-6 * body.length_scale
    return replace(
        edges,
        exponents=exponents,
        kinds=kinds,
        names=[*edges.names, FIBRES],
        segments=np.concatenate([edges.segments, np.stack([gathered - half, gathered + half], axis=1)]),
        segment_exponents=np.concatenate([edges.segment_exponents, np.full(len(gathered), SCALE_FREE)]),
    )


@dataclass(frozen=True)
class _SingularEdges:
    """Singular edges: global ``vertices`` (e, 2), their ``points`` (e, 2, 3), exponents and kinds (e,)."""

    vertices: Ints
    points: Floats
    exponents: Floats
    kinds: Ints
    names: list[str]


def _cell_edges(body: Body, edges: _SingularEdges) -> SingularEdges:
    mesh = body.mesh
    owned = mesh.topology.index_map(3).size_local
    nodes = mesh.geometry.dofmaps[0][:owned, : mesh.ufl_cell().num_vertices]
    count = len(mesh.geometry.x)
    least, kinds = np.full(count, SMOOTH), np.full(count, -1, dtype=np.int64)
    order = np.argsort(-edges.exponents, kind="stable")  # the lowest is written last
    local = mesh.geometry.index_map().global_to_local(edges.vertices[order].ravel()).reshape(-1, 2)
    for end in local.T:
        here = end >= 0
        lower = edges.exponents[order[here]] < least[end[here]]
        least[end[here][lower]] = edges.exponents[order[here]][lower]
        kinds[end[here][lower]] = edges.kinds[order[here]][lower]
    lowest = least[nodes].argmin(axis=1) if owned else np.zeros(0, dtype=np.int64)
    chosen = nodes[np.arange(owned), lowest]
    points = edges.points * body.length_scale
    return SingularEdges(least[chosen], kinds[chosen], edges.names, points, edges.exponents)


def _edges(
    kind: str, facets: Ints, corners: Floats, areas: Floats, held: Ints, regions: Sequence[str], kappa: float
) -> _SingularEdges:
    """Find the singular edges among the facets of a whole boundary.

    Args:
        facets: global vertices (f, k); corners: their coordinates (f, k, 3).
        areas: area vectors (f, 3), out of the body.
        held: components that each support holds on each facet (f, supports), a bit for each axis and the normal.
    """
    local = sub_entities(kind, 1)
    vertices, place = unique_rows(np.sort(facets[:, local].reshape(-1, 2), axis=1))
    order = np.argsort(place, kind="stable")
    starts = np.searchsorted(place[order], np.arange(len(vertices)))
    is_between_two = np.bincount(place, minlength=len(vertices)) == 2
    starts = starts[is_between_two]
    pair = np.stack([order[starts], order[starts + 1]], axis=1) // len(local)  # facets of each edge
    local_edge = order[starts] % len(local)
    ends = corners[pair[:, :1], local[local_edge]]
    normals = areas / np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), 1e-300)
    first, second = normals[pair[:, 0]], normals[pair[:, 1]]
    middles = corners.mean(axis=1)
    turn = np.arctan2(np.linalg.norm(np.cross(first, second), axis=1), np.sum(first * second, axis=1))
    is_reentrant = np.sum((middles[pair[:, 1]] - middles[pair[:, 0]]) * first, axis=1) > 0
    excess = np.where(is_reentrant, turn, -turn)
    masks = np.bitwise_or.reduce(held, axis=1) if held.shape[1] else np.zeros(len(facets), dtype=np.int64)
    pair_masks = masks[pair]
    is_end = pair_masks[:, 0] != pair_masks[:, 1]
    highest, second_highest = _highest_angles(excess, pair, len(facets))
    neighbour_angle = np.where(excess[:, None] >= highest[pair], second_highest[pair], highest[pair]).max(axis=1)
    candidate = np.flatnonzero(
        is_end | _is_sharp(excess, neighbour_angle) | (pair_masks.any(axis=1) & (excess < -LEAST))
    )
    tangents = ends[:, 1] - ends[:, 0]
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-300)
    numbers, exponents, kinds, names = list[int](), list[float](), list[int](), dict[str, int]()
    for edge in candidate:
        angle = math.radians(round(math.degrees(math.pi + excess[edge])))
        holds = [_holds(int(masks[f]), normals[f], tangents[edge]) for f in pair[edge]]
        sliding = [hold is Hold.SLIDING for hold, _ in holds]
        if sliding[0] is not sliding[1]:  # the mirror image of the other facet is its neighbour
            other = pair[edge][sliding.index(False)]
            if not _is_sharp(2 * angle - math.pi, highest[other]):
                continue
        numbers.append(int(edge))
        normal_exponent = plane_exponent(angle, holds[0][0], holds[1][0], kappa)
        exponents.append(min(normal_exponent, axial_exponent(angle, holds[0][1], holds[1][1])))
        ending = [r for r, (a, b) in zip(regions, held[pair[edge]].T, strict=True) if a != b]
        name = f"edge of the support '{ending[0]}'" if ending else f"re-entrant edge of {math.degrees(angle):.0f}°"
        kinds.append(names.setdefault(name, len(names)))
    is_limiting = np.array(exponents, dtype=np.float64) < LIMITING
    kept = np.array(numbers, dtype=np.int64)[is_limiting]
    limiting = np.array(exponents, dtype=np.float64)[is_limiting], np.array(kinds, dtype=np.int64)[is_limiting]
    return _SingularEdges(vertices[is_between_two][kept], ends[kept], *limiting, list(names))


def _highest_angles(excess: Floats, pair: Ints, facets: int) -> tuple[Floats, Floats]:
    """Return the highest and the second highest re-entrant angle at each facet, each (facets,), 0 for none."""
    facet, angle = pair.T.ravel(), np.tile(np.clip(excess, 0, None), 2)
    order = np.lexsort((angle, facet))
    facet, angle = facet[order], angle[order]
    ends = np.searchsorted(facet, np.arange(facets), side="right")
    counts = np.bincount(facet, minlength=facets)
    last, second = np.maximum(ends - 1, 0), np.maximum(ends - 2, 0)
    return np.where(counts > 0, angle[last], 0.0), np.where(counts > 1, angle[second], 0.0)


def _is_sharp(angle: Any, neighbour_angle: Any) -> Any:
    """Return whether a re-entrant angle is not one between facets of a curved surface.

    Facets of a curved surface meet their neighbours on the other side under nearly the same angle ``neighbour_angle``.
    """
    return (angle > CURVED) | ((angle > LEAST) & (angle >= SHARPER * neighbour_angle))


def _holds(mask: int, normal: Floats, tangent: Floats) -> tuple[Hold, bool]:
    """Return how a face that holds the directions of a ``mask`` is held across an edge, and whether along it."""
    axes = np.eye(3)[[axis for axis in range(3) if mask >> axis & 1]]
    if mask & _NORMAL and np.linalg.matrix_rank(np.vstack([axes, normal]), 1e-6) > len(axes):
        axes = np.linalg.qr(np.vstack([axes, normal]).T)[0].T
    # Directions across the edge that are held: axes that have no component along it.
    tangential = axes @ tangent
    if len(axes) == 3:
        return Hold.CLAMPED, True
    if len(axes) == 2:
        is_clamped = bool(np.abs(tangential).max() < 1e-6)
        free = np.cross(*axes)
        return (Hold.CLAMPED if is_clamped else Hold.SLIDING), bool(abs(free @ tangent) < 1e-6)
    if len(axes) == 1:
        return (Hold.SLIDING if abs(tangential[0]) < 1e-6 else Hold.FREE), bool(abs(tangential[0]) > 1 - 1e-6)
    return Hold.FREE, False
