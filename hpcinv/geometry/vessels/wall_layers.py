"""Layers of tetrahedra between a surface of triangles and another one at a distance from it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyvista
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra
from vtkmodules.util import numpy_support
from vtkmodules.vtkCommonCore import vtkDoubleArray
from vtkmodules.vtkFiltersCore import vtkImplicitPolyDataDistance

from hpcinv.geometry.imaging.lattice import scaled_jacobians
from hpcinv.mesh.source import Floats, Ints

_ROUNDS = 120  # of smoothing; each takes a distance of the nodes that it changes
_FEWEST = 20  # rounds that try to improve poor cells; more rarely do
_WIDER = 10  # rounds until directions are smoothed one row of nodes farther; more rounds are needed if raised
_STEPS = 40  # along a ray, each by what is missing to the thickness
_NEAR = 1e-4  # relative to the thickness
_FARTHEST = 3.0  # length of a ray, relative to the thickness: where walls of branches join
_SMALLEST = 0.15  # area of a facet in any layer, relative to the one inside; lower values let cells degenerate
_STEEPEST = 0.25  # cosine of the angle between a facet's normal and a direction; lower values let cells lean over
_POOR = 0.05  # scaled Jacobian; raised, walls are thicker where branches part
_FRACTIONS = (0.25, 0.5, 0.75, 1.0)


class NoWall(Exception):
    """The wall is too thick for its surface.

    Attributes:
        point: (3,) where.
    """

    def __init__(self, point: Floats) -> None:
        super().__init__(str(point))
        self.point = point


class Distance:
    """Distance of points from a surface of triangles, whose search tree is built once."""

    def __init__(self, surface: pyvista.PolyData) -> None:
        self._function = vtkImplicitPolyDataDistance()
        self._function.SetInput(surface)

    def __call__(self, points: Floats) -> Floats:
        """Return the distances (n,) of points (n, 3)."""
        measured = vtkDoubleArray()
        to_vtk: Any = numpy_support.numpy_to_vtk
        to_numpy: Any = numpy_support.vtk_to_numpy
        self._function.FunctionValue(to_vtk(np.ascontiguousarray(points)), measured)
        return np.abs(np.asarray(to_numpy(measured), dtype=np.float64))


@dataclass(frozen=True)
class Base:
    """A surface of triangles from which layers grow.

    Attributes:
        points: (n, 3).
        triangles: (m, 3), whose normals point to the layers.
        in_plane: normal (n, 3) of the plane in which the directions of nodes at flat ends stay, 0 elsewhere.
    """

    points: Floats
    triangles: Ints
    in_plane: Floats

    def corner_normals(self) -> Floats:
        """Return area vectors (m, 3) of the triangles."""
        a, b, c = (self.points[self.triangles[:, i]] for i in range(3))
        return np.asarray(np.cross(b - a, c - a))

    def neighbours(self) -> csr_array:
        """Return the matrix of the means over neighbours, by rows."""
        pairs = np.concatenate([self.triangles[:, [0, 1]], self.triangles[:, [1, 2]], self.triangles[:, [2, 0]]])
        pairs = np.concatenate([pairs, pairs[:, ::-1]])
        touch = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(self.points),) * 2).tocsr()
        touch.data[:] = 1.0
        return csr_array(touch.multiply(1 / touch.sum(axis=1)[:, None]))

    def in_planes(self, directions: Floats) -> Floats:
        """Return unit vectors, in the plane at flat ends."""
        flat = directions - np.einsum("ij,ij->i", directions, self.in_plane)[:, None] * self.in_plane
        return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300))


def outer_points(base: Base, distance: Distance, thickness: Floats, layers: int) -> Floats:
    """Return points (n, 3) whose distance from an inner surface is the thickness (n,).

    They lie along normals of the base. Where these would meet, or make poor cells, directions are smoothed, so that
    walls of branches join.

    Raises:
        NoWall: facets would fold over even so.
    """
    normals = np.zeros_like(base.points)
    areas = base.corner_normals()
    for corner in range(3):
        np.add.at(normals, base.triangles[:, corner], areas)
    directions = base.in_planes(normals)
    mean = base.neighbours()
    changed = np.arange(len(base.points))
    outer, best, least = base.points.copy(), None, -1.0
    for turn in range(_ROUNDS):
        outer[changed] = march(base.points[changed], directions[changed], thickness[changed], distance)
        bad = _folded(base, outer)
        if not bad.any():
            quality = _shapes(base, outer, layers)
            if quality.min() > least:
                best, least = outer.copy(), float(quality.min())
            bad = quality < _POOR
        if not bad.any() or (best is not None and turn >= _FEWEST):
            break
        near = np.zeros(len(base.points))
        near[base.triangles[bad]] = 1.0
        for _ in range(1 + turn // _WIDER):
            near += mean @ near
        changed = np.flatnonzero(near)
        directions[changed] = base.in_planes(directions + mean @ directions)[changed]
    if best is None:
        raise NoWall(base.points[base.triangles[bad]].mean(axis=1)[0])
    return best


def march(points: Floats, directions: Floats, thickness: Floats, distance: Distance) -> Floats:
    """Return the points on rays whose distance from a surface is the thickness (n,)."""
    length = np.zeros(len(points))
    active = np.arange(len(points))
    for _ in range(_STEPS):
        places = points[active] + length[active, None] * directions[active]
        missing = thickness[active] - distance(places)
        length[active] = np.clip(length[active] + missing, 0.0, _FARTHEST * thickness[active])
        active = active[
            (np.abs(missing) > _NEAR * thickness[active]) & (length[active] < _FARTHEST * thickness[active])
        ]
        if not len(active):
            break
    return np.asarray(points + length[:, None] * directions)


def _folded(base: Base, outer: Floats) -> npt.NDArray[np.bool_]:
    """Return which triangles turn over, or nearly vanish, on their way to the outer points."""
    way = outer - base.points
    first = base.corner_normals()
    heights = [np.einsum("ij,ij->i", first, way[nodes]) for nodes in base.triangles.T]
    lengths = np.linalg.norm(first, axis=1)
    bad = np.zeros(len(base.triangles), dtype=bool)
    for nodes, height in zip(base.triangles.T, heights, strict=True):
        bad |= height < _STEEPEST * lengths * np.linalg.norm(way[nodes], axis=1)
    for fraction in _FRACTIONS:
        a, b, c = (base.points[nodes] + fraction * way[nodes] for nodes in base.triangles.T)
        normal = np.cross(b - a, c - a)
        for nodes, height in zip(base.triangles.T, heights, strict=True):
            bad |= np.einsum("ij,ij->i", normal, way[nodes]) < _SMALLEST * height
    return bad


def _shapes(base: Base, outer: Floats, layers: int) -> Floats:
    """Return the scaled Jacobian of the worst cell above each triangle."""
    points = layer_points(base.points, outer, layers)
    corners = points[tetrahedra(base.triangles, len(base.points), layers)]
    quality = np.abs(scaled_jacobians(corners)).reshape(-1, len(base.triangles))
    return np.asarray(quality.min(axis=0))


def layer_points(inner: Floats, outer: Floats, layers: int) -> Floats:
    """Return the points of layers, from the inner to the outer ones."""
    return np.concatenate([inner + k / layers * (outer - inner) for k in range(layers + 1)])


def tetrahedra(triangles: Ints, count: int, layers: int) -> Ints:
    """Return the cells (n, 4) of layers over triangles; node ``i`` of layer ``k`` is ``k count + i``.

    Each prism is divided so that neighbours agree: along edges from the smaller number below to the larger above.
    """
    a, b, c = np.sort(triangles, axis=1).T
    cells = []
    for k in range(layers):
        low, high = k * count, (k + 1) * count
        cells += [
            np.column_stack([a + low, b + low, c + low, c + high]),
            np.column_stack([a + low, b + low, b + high, c + high]),
            np.column_stack([a + low, a + high, b + high, c + high]),
        ]
    return np.concatenate(cells)


def side_facets(edges: Ints, count: int, layers: int) -> Ints:
    """Return the facets (n, 3) of the cells of `tetrahedra` over edges of the base."""
    a, b = np.sort(edges, axis=1).T
    facets = []
    for k in range(layers):
        low, high = k * count, (k + 1) * count
        facets += [
            np.column_stack([a + low, b + low, b + high]),
            np.column_stack([a + low, a + high, b + high]),
        ]
    return np.concatenate(facets)


def lengths_along(base: Base, start: Sequence[int] | Ints) -> Floats:
    """Return the distance (n,) of each node from the nearest of some, along edges and across pairs of triangles."""
    pairs = np.concatenate([base.triangles[:, [0, 1]], base.triangles[:, [1, 2]], base.triangles[:, [2, 0]]])
    opposite = np.concatenate([base.triangles[:, 2], base.triangles[:, 0], base.triangles[:, 1]])
    order = np.lexsort(np.sort(pairs, axis=1).T)
    key = np.sort(pairs, axis=1)[order]
    same = np.flatnonzero((key[1:] == key[:-1]).all(axis=1))
    across = np.column_stack([opposite[order[same]], opposite[order[same + 1]]])
    edges = np.unique(np.sort(np.concatenate([pairs, across]), axis=1), axis=0)
    lengths = np.linalg.norm(base.points[edges[:, 0]] - base.points[edges[:, 1]], axis=1)
    graph = coo_array((lengths, edges.T), shape=(len(base.points),) * 2).tocsr()
    far = dijkstra(graph, directed=False, indices=np.asarray(start), min_only=True)
    return np.asarray(far, dtype=np.float64)
