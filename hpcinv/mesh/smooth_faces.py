"""Smooth faces of a boundary: a facet with all that is reached from it over edges that are not sharp."""

import numpy as np
import numpy.typing as npt

from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh.boundary_shells import Mesh, outer_facets
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.topology import connected, unique_rows

_ROW_BY_ROW = np.array([0, 1, 3, 2])  # DOLFINx numbers the vertices of a quadrilateral so
_TIE = 1e-9  # of the body, between distances that are equal; if it is raised, the order of the nodes decides more often


def smooth_face(mesh: Mesh, exterior: LocalIndices, point: Floats, angle: float) -> npt.NDArray[np.bool_]:
    """Return which boundary facets of this rank are on the smooth face nearest to a point; collective.

    Args:
        exterior: the facets of the boundary on this rank.
        point: (3,) in the coordinates of the mesh.
        angle: rad between the normals of two neighbours above which their edge is sharp.
    """
    nodes, areas = outer_facets(mesh, exterior)
    if nodes.shape[1] == 4:
        nodes = nodes[:, _ROW_BY_ROW]
    numbers = np.asarray(mesh.geometry.input_global_indices, dtype=np.int64)[nodes]
    gathered = mesh.comm.gather((numbers, areas, mesh.geometry.x[nodes]))
    shares = None
    if gathered is not None:
        facets, vectors, corners = map(np.concatenate, zip(*gathered, strict=True))
        distances = _distances(corners, point)
        nearest = np.flatnonzero(distances <= distances.min() + _TIE * np.ptp(corners, axis=(0, 1)).max())
        seed = nearest[np.lexsort(np.sort(facets[nearest], axis=1).T)[0]]  # the same on any number of ranks
        face = smooth_faces(facets, vectors, angle)
        shares = np.split(face == face[seed], np.cumsum([len(part[0]) for part in gathered])[:-1])
    return np.asarray(mesh.comm.scatter(shares))


def smooth_faces(facets: Ints, areas: Floats, angle: float) -> Ints:
    """Return the number of the smooth face of each facet, from 0; edges of more than two facets are sharp.

    Args:
        facets: vertices (n, k), in order around each facet.
        areas: outward area vectors, (n, 3).
    """
    count = facets.shape[1]
    edges = np.sort(np.stack([facets, np.roll(facets, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, place = unique_rows(edges)
    order = np.argsort(place, kind="stable")
    first = np.flatnonzero(np.diff(place[order], prepend=-1))
    pairs = first[np.diff(first, append=len(order)) == 2]
    sides = np.stack([order[pairs], order[pairs + 1]], axis=1) // count
    normals = areas / np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), np.finfo(float).tiny)
    cosines = np.einsum("ni,ni->n", normals[sides[:, 0]], normals[sides[:, 1]])
    each = np.arange(len(facets))
    joined = np.concatenate([np.stack([each, each], axis=1), sides[cosines >= np.cos(angle)]])
    return connected(joined, len(facets))[: len(facets)]


def _distances(corners: Floats, point: Floats) -> Floats:
    """Return the distance of a point from each facet (n, k, 3), taken as triangles around its first corner."""
    triangles = [corners[:, [0, k, k + 1]] - point for k in range(1, corners.shape[1] - 1)]
    return np.asarray(np.min([_triangle_distances(triangle) for triangle in triangles], axis=0))


def _triangle_distances(corners: Floats) -> Floats:
    """Return the distance of the origin from each triangle (n, 3, 3): inside, or the smallest from its sides."""
    a, b, c = corners.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    size = np.maximum(np.linalg.norm(normal, axis=1), np.finfo(float).tiny)
    distance = np.full(len(a), np.inf)
    inside = np.ones(len(a), dtype=bool)
    for p, q in ((a, b), (b, c), (c, a)):
        side = q - p
        share = np.einsum("ni,ni->n", -p, side) / np.maximum(np.einsum("ni,ni->n", side, side), np.finfo(float).tiny)
        distance = np.minimum(distance, np.linalg.norm(p + np.clip(share, 0, 1)[:, None] * side, axis=1))
        inside &= np.einsum("ni,ni->n", np.cross(side, -p), normal) >= 0
    return np.where(inside, np.abs(np.einsum("ni,ni->n", a, normal)) / size, distance)
