"""Facets of a boundary that cross each other: the body passes through itself there."""

from dataclasses import dataclass

import numpy as np

from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.surface import Surface, Triangles
from hpcinv.mesh.topology import find_rows, unique_rows
from hpcinv.mesh.triangles import crossing, meeting

_TOUCH = 1e-9  # of the body's diagonal: depth up to which parts touch
_OF_EDGE = 1e-3  # and of the shortest edge, so that thin walls and fine parts stay as they are
_FLAT = 1e-6  # regularisation of least squares where the surface is flat
_CHUNK = 200_000  # pairs of triangles at a time, to bound the memory
_FINER = 4  # further subdivisions of curved facets; a crossing must persist on them


@dataclass(frozen=True)
class Overlap:
    """Number of pairs of boundary facets that cross, a point (m) of one pair, ``None`` if none do, and these facets."""

    pairs: int
    point: tuple[float, float, float] | None
    facets: frozenset[int] = frozenset()


def find_overlap(surface: Surface) -> Overlap:
    """Find where a boundary on this process passes through itself; not collective.

    Parts that touch, up to 1e-9 of the body's diagonal, do not cross. Curved facets are compared as triangles, at first
    between their nodes, then four times finer: overlaps flatter than what these leave out may go unseen.
    """
    pairs, points = _crossing_facets(surface.cut(surface.degree, np.arange(len(surface.nodes))))
    if len(pairs) and not surface.is_flat:
        pairs, points = _crossing_facets(surface.cut(_FINER * surface.degree, np.unique(pairs)), pairs)
    if not len(pairs):
        return Overlap(0, None)
    x, y, z = points[0].tolist()
    return Overlap(len(pairs), (x, y, z), frozenset(np.unique(pairs).tolist()))


def _crossing_facets(triangles: Triangles, candidate_pairs: Ints | None = None) -> tuple[Ints, Floats]:
    """Distinct pairs of facets with triangles that cross, (n, 2), and a point (n, 3) of each.

    Args:
        candidate_pairs: the distinct pairs of facets (m, 2) that are in question; all if ``None``.
    """
    shrunk = _shrunk(triangles)
    triangle_pairs = meeting(shrunk, triangles.corners)
    if candidate_pairs is not None:
        triangle_pairs = triangle_pairs[
            find_rows(np.sort(triangles.facet[triangle_pairs], axis=1), candidate_pairs) >= 0
        ]
    pairs, points = [np.zeros((0, 2), dtype=np.int64)], [np.zeros((0, 3))]
    for i, j in (part.T for part in np.array_split(triangle_pairs, 1 + len(triangle_pairs) // _CHUNK)):
        crosses, where = crossing(shrunk, triangles.corners[i], triangles.corners[j])
        pairs.append(np.sort(triangles.facet[np.stack([i[crosses], j[crosses]], axis=1)], axis=1))
        points.append(where[crosses])
    distinct, place = unique_rows(np.concatenate(pairs))
    positions = np.empty((len(distinct), 3))
    positions[place] = np.concatenate(points)
    return distinct, positions


def _shrunk(triangles: Triangles) -> Floats:
    """Return the points of a surface, each moved into the body by a slightly different small distance.

    Parts that touch are apart then, those that overlap still do, and none of them lie edge on edge or face in face any
    more, where no edge goes through the inside of a triangle.

    A point moves by ``-h d`` with ``n·d = 1`` for the normals n of the triangles around it, as well as that is possible
    (least squares): so it moves away from each of their planes, also at sharp edges.
    """
    points, corners = triangles.points, triangles.corners
    a, b, c = (points[corners[:, k]] for k in range(3))
    shortest = min(float(np.linalg.norm(q - p, axis=1).min()) for p, q in ((a, b), (b, c), (c, a)))
    hair = min(_TOUCH * float(np.linalg.norm(np.ptp(points, axis=0))), _OF_EDGE * shortest)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    total, dyads = np.zeros_like(points), np.tile(_FLAT * np.eye(3), (len(points), 1, 1))
    for k in range(3):
        np.add.at(total, corners[:, k], normals)
        np.add.at(dyads, corners[:, k], normals[:, :, None] * normals[:, None, :])
    inwards = np.linalg.solve(dyads, total[:, :, None])[:, :, 0]
    shrunk: Floats = points - hair * np.random.default_rng(0).uniform(1.0, 2.0, (len(points), 1)) * inwards
    return shrunk
