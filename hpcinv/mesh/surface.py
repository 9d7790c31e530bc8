"""Triangulated boundary of a whole body on one process; curved facets are subdivided."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

import dolfinx
import numpy as np
import numpy.typing as npt

from hpcinv.mesh.boundary_shells import cells_and_sides
from hpcinv.mesh.cells import FACET_KIND, jacobians, scalar_element, sub_entities
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.mesh.topology import unique_rows, vertex_sets

if TYPE_CHECKING:
    from hpcinv.base.quantity.arrays import LocalIndices
    from hpcinv.mesh import Body

_VALUES_AT_ONCE = 3_000_000


@dataclass(frozen=True)
class Triangles:
    """Triangles that share their corners and are oriented with their normals out of the body.

    Attributes:
        points: corners, (n, 3) in m.
        corners: triangles as rows of ``points``, (m, 3).
        facet: the facet that each triangle is of, (m,).
    """

    points: Floats
    corners: Ints
    facet: Ints


@dataclass(frozen=True)
class Surface:
    """Boundary facets of a body, in an order that does not depend on the number of ranks.

    Attributes:
        kind, degree: of the facets.
        tags: numbers of the facets' nodes, (f, n), in the order of the reference facet.
        nodes: their coordinates, (f, n, 3) in m.
        outward: whether the reference facet's normal points out of the body, (f,).
        values: what was gathered for each facet, (f, m).
    """

    kind: str
    degree: int
    tags: Ints
    nodes: Floats
    outward: npt.NDArray[np.bool_]
    values: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    def chord_error(self, divisions: int) -> float:
        """Return the largest distance (m) between the facets and their cut into ``divisions``, with middles on facets.

        It is taken between points of the same reference coordinates, in the middles of triangles and of their sides:
        the surfaces are not farther apart there.
        """
        corners = ((0, 1), (1, 2), (2, 0), (0, 1, 2))
        lengths = [np.linalg.norm(chords, axis=2).max(initial=0.0) for chords in self._chords(divisions, corners)]
        return float(max(lengths, default=0.0))

    def rises(self, divisions: int) -> Floats:
        """Return the vector (m, 3) from the middle of each triangle of that cut of all facets to the facet."""
        return np.concatenate([chords.reshape(-1, 3) for chords in self._chords(divisions, ((0, 1, 2),))])

    def _chords(self, divisions: int, corners: Sequence[tuple[int, ...]]) -> Iterator[Floats]:
        """Yield vectors (f, triangles, 3) from means of corners of triangles to the facets, for parts of the facets."""
        lattice, triangles, _ = _pattern(self.kind, divisions)
        element, places = scalar_element(self.kind, self.degree), lattice.mean(axis=1)
        nodes = element.tabulate(0, places)[0, :, :, 0]
        chunk = max(1, _VALUES_AT_ONCE // (3 * len(triangles)))
        for some in corners:
            parts = triangles[:, some]
            difference = element.tabulate(0, places[parts].mean(axis=1))[0, :, :, 0] - nodes[parts].mean(axis=1)
            for begin in range(0, len(self.nodes), chunk):
                yield difference @ self.nodes[begin : begin + chunk]

    @property
    def is_flat(self) -> bool:
        """Return whether the facets are flat triangles."""
        return self.kind == "triangle" and self.degree == 1

    def cut(self, divisions: int, facets: Ints, *, middles_on_facets: bool = False) -> Triangles:
        """Divide each side of some facets into ``divisions`` parts, and triangulate the facets.

        A triangle becomes ``divisions²`` of them, a quadrilateral four times as many, which meet in the middles of its
        parts: so the cut of a facet is the same whichever of its corners comes first.

        Args:
            middles_on_facets: whether these middles are on curved facets, which could invert thin parts; otherwise they
                are the corners'.
        """
        lattice, triangles, weights = _pattern(self.kind, divisions)
        element = scalar_element(self.kind, self.degree)
        if middles_on_facets:
            shapes = element.tabulate(0, lattice.mean(axis=1))[0, :, :, 0]
        else:
            shapes = element.tabulate(0, lattice.reshape(-1, 2))[0, :, :, 0]
            shapes = shapes.reshape(*lattice.shape[:2], -1).mean(axis=1)
        points = (shapes @ self.nodes[facets]).reshape(-1, 3)
        # Points are identified by their weights on the corners of the facet, which are shared along a common side.
        keys = self.tags[facets][:, None, : weights.shape[1]] * (int(weights.max()) + 1) + weights
        keys = np.sort(np.where(weights > 0, keys, -1), axis=2).reshape(len(points), -1)
        distinct, place = unique_rows(keys)
        shared = np.empty((len(distinct), 3))
        shared[place] = points
        corners = place.reshape(len(facets), -1)[:, triangles]
        corners = np.where(self.outward[facets, None, None], corners, corners[:, :, ::-1])
        return Triangles(shared, corners.reshape(-1, 3), np.repeat(facets, len(triangles)))


type SurfaceEvaluation = Callable[[LocalIndices, LocalIndices, Floats], Floats]
"""values (f, m) of local facets (f,), of the cells (f,) that they belong to, and of their middles (f, 3) there"""


def surface_of(source: MeshSource, cells: Ints | None = None) -> Surface:
    """Return the boundary of a whole mesh on one process, or of some of its cells."""
    kind, degree = source.kind, source.degree
    nodes = source.cells if cells is None else source.cells[cells]
    sides = sub_entities(kind, 2)
    _, place = unique_rows(vertex_sets(nodes, sides))
    alone = np.flatnonzero(np.bincount(place)[place] == 1)
    cell, which = np.divmod(alone, len(sides))
    table, turned = _facets_of_reference_cell(kind, degree)
    tags = nodes[cell[:, None], table[which]]
    middle = scalar_element(kind, 1).points.mean(axis=0)[None]
    determinants = np.linalg.det(jacobians(kind, degree, source.points[nodes[cell]], middle)[:, 0])
    return Surface(FACET_KIND[kind], degree, tags, source.points[tags], turned[which] == (determinants > 0))


def gather_surface(body: Body, nodes: Floats, evaluate: SurfaceEvaluation | None = None) -> Surface | None:
    """Gather on rank 0 the boundary of a body with its local geometry nodes at ``nodes`` (n, 3) m; collective."""
    mesh, kind, degree = body.mesh, body.source.kind, body.degree
    topology, geometry = mesh.topology, mesh.geometry
    topology.create_connectivity(2, 3)
    facets = dolfinx.mesh.exterior_facet_indices(topology)
    cells, which = cells_and_sides(mesh, facets)
    table, turned = _facets_of_reference_cell(kind, degree)
    local = geometry.dofmaps[0][cells[:, None], table[which]]
    middle = scalar_element(kind, 1).points.mean(axis=0)[None]
    determinants = np.linalg.det(jacobians(kind, degree, geometry.x[geometry.dofmaps[0][cells]], middle)[:, 0])
    outward = turned[which] == (determinants > 0)  # normals are reversed in a mesh that is left-handed throughout
    order = np.stack([np.asarray(topology.original_cell_index)[cells], which], axis=1)
    tags = geometry.input_global_indices[local].astype(np.int64)
    middles = scalar_element(kind, 1).points[sub_entities(kind, 2)].mean(axis=1)[which]
    values = evaluate(facets, cells, middles) if evaluate else np.zeros((len(facets), 0))
    gathered = mesh.comm.gather((order, tags, nodes[local], outward, values))
    if gathered is None:
        return None
    order, tags, points, outward, values = map(np.concatenate, zip(*gathered, strict=True))
    first = np.lexsort(order.T[::-1])
    return Surface(FACET_KIND[kind], degree, tags[first], points[first], outward[first], values[first])


@cache
def _facets_of_reference_cell(kind: str, degree: int) -> tuple[Ints, npt.NDArray[np.bool_]]:
    """Return the nodes of each facet in reference order, and whether its reference normal points outwards."""
    vertices: Floats = scalar_element(kind, 1).points
    cell_nodes: Floats = scalar_element(kind, degree).points
    facet_shapes = scalar_element(FACET_KIND[kind], 1).tabulate(0, scalar_element(FACET_KIND[kind], degree).points)
    corners = vertices[sub_entities(kind, 2)]
    nodes = facet_shapes[0, :, :, 0] @ corners
    table = np.abs(nodes[:, :, None] - cell_nodes).max(axis=3).argmin(axis=2)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return table, np.einsum("fi,fi->f", normals, corners[:, 0] - vertices.mean(axis=0)) > 0


@cache
def _pattern(kind: str, divisions: int) -> tuple[Floats, Ints, Ints]:
    """Subdivision of a facet.

    Returns:
        The points, each as the mean of k points of the reference facet (n, k, 2); the triangles between them; integer
        weights of each point on the facet's corners.
    """
    if kind == "triangle":
        points = [(i, j) for i in range(divisions + 1) for j in range(divisions + 1 - i)]
        upright = [((i, j), (i + 1, j), (i, j + 1)) for i, j in points if i + j < divisions]
        hanging = [((i + 1, j), (i + 1, j + 1), (i, j + 1)) for i, j in points if i + j < divisions - 1]
        triangles, steps, corners = upright + hanging, divisions, [(0, 0)]
    else:
        # Midpoints are those between the corners, not on the facet, which could invert thin curved parts.
        steps, corners = 2 * divisions, [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        points = [(i, j) for i in range(steps + 1) for j in range(steps + 1) if i % 2 == j % 2]
        sides = list(zip(corners, corners[1:] + corners[:1], strict=True))
        triangles = [
            ((i, j), (i + a[0], j + a[1]), (i + b[0], j + b[1])) for i, j in points if i % 2 == 1 for a, b in sides
        ]
    i, j = np.array(points).T
    n = steps
    weights = [n - i - j, i, j] if kind == "triangle" else [(n - i) * (n - j), i * (n - j), (n - i) * j, i * j]
    spread = np.array(corners) * (i % 2)[:, None, None] if kind == "quadrilateral" else np.zeros((1, 1, 2))
    number = {point: k for k, point in enumerate(points)}
    return (
        (np.stack([i, j], axis=1)[:, None] + spread) / n,
        np.array([[number[point] for point in triangle] for triangle in triangles], dtype=np.int64),
        np.stack(weights, axis=1).astype(np.int64),
    )
