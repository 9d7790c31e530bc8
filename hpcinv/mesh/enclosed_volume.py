"""Volume of a cavity of the body, between boundary facets and lids on their openings.

By the divergence theorem, with the normal n out of the cavity,

    V = 1/3 ∫ x·n da over the surface + 1/3 Σ c_i·A_i over the openings,

where the lid of an opening is a cone of straight lines from its rim to the apex ``c_i``: it has the area vector
``A_i = 1/2 ∮ x × dx``, which the rim alone determines, and ``(x - c_i)·n = 0``. The apex is fixed, or the mean of the
rim's vertices. If the rim is in a plane, the lid is too, wherever in that plane the apex is.

V is a cubic polynomial of the nodes, integrated exactly on curved facets.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import MeshError
from hpcinv.mesh.body import Body
from hpcinv.mesh.cells import kind_and_degree, quadrature, scalar_element, sub_entities, vertex_count
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.topology import connected, unique_rows

_LOOPS = {3: (0, 1, 2), 4: (0, 1, 3, 2)}
"""vertices of triangles and quadrilaterals in the order in which their boundary passes them"""


@dataclass(frozen=True)
class _Tabulated:
    """Weights of points on a facet or edge of a cell, and values and derivatives there of the cell's shape functions.

    Values and derivatives are (points, nodes); derivatives are along the edges from the first vertex to the others.
    """

    weights: Floats
    values: Floats
    slopes: tuple[Floats, ...]


@cache
def _on_entity(kind: str, degree: int, vertices: tuple[int, ...]) -> _Tabulated:
    """Tabulate the facet or edge of a cell that has these vertices, for the exact integral of its volume."""
    corners = basix.geometry(basix.CellType[kind])[list(vertices)]
    shape, axes = {2: ("interval", 1), 3: ("triangle", 2), 4: ("quadrilateral", 2)}[len(corners)]
    directions = corners[1 : axes + 1] - corners[0]
    points, weights = quadrature(shape, 3 * degree)
    table = scalar_element(kind, degree).tabulate(1, corners[0] + points @ directions)[..., 0]
    slopes = tuple(np.einsum("i,ipn->pn", direction, table[1:]) for direction in directions)
    return _Tabulated(weights, table[0], slopes)


@dataclass(frozen=True)
class _Entities:
    """Facets or edges at the same place of their cells.

    Attributes:
        cells: local numbers of the cells.
        signs: 1 where the order of the vertices belongs to the normal out of the cavity, else -1.
        vertices: vertices in a cell.
        rims: numbers of the openings of edges.
    """

    cells: Ints
    signs: Floats
    vertices: tuple[int, ...]
    rims: Ints


@dataclass(frozen=True)
class _Shape:
    """Volume of a cavity relative to an origin, and area vectors and apexes of its lids, (openings, 3)."""

    volume: float
    origin: Floats
    areas: Floats
    apexes: Floats


class EnclosedVolume:
    """Volume of a cavity as a function of the geometry nodes of a body.

    Args:
        regions: names of the regions of the boundary around the cavity.
        apex: fixed apex (m) of all lids; without it, of each the mean of its rim's vertices.

    Attributes:
        openings: number of openings.

    Raises:
        MeshError: on all ranks, if the regions do not enclose a cavity.
    """

    def __init__(self, body: Body, regions: Sequence[str], apex: Sequence[float] | None) -> None:
        self._comm = body.mesh.comm
        self._kind, self._degree = kind_and_degree(body.mesh)
        self._cell_nodes = body.mesh.geometry.dofmaps[0]
        self._apex = None if apex is None else np.array(apex)
        remedy = "The surface of a cavity, and a region that is its lid, must be regions of the boundary."
        facets = np.unique(np.concatenate([body.boundary_facets(name, remedy) for name in regions]))
        pairs = fem.compute_integration_domains(fem.IntegralType.exterior_facet, body.mesh.topology, facets)
        cells, sides = pairs.reshape(-1, 2).astype(np.int64).T
        self._facets = list(self._oriented(body.given_nodes, cells, sides))
        self._edges, self._edge_counts = self._rims(body)
        names = " and ".join(f"'{name}'" for name in regions)
        if not self.volume(body.given_nodes) > 0:
            raise MeshError(
                f"{body.source.path}: {names} encloses no cavity: its normals do not point into the space around it",
                "Name the inner surface of a hollow body.",
            )

    @property
    def openings(self) -> int:
        return len(self._edge_counts)

    def volume(self, nodes: Floats) -> float:
        """Return the volume (m³) with the local geometry nodes at ``nodes``, (n, 3) in m; collective."""
        return self._shape(nodes).volume

    def unevenness(self, nodes: Floats) -> float:
        """Return the largest distance of a rim's vertex from the plane of its lid, relative to √area; collective."""
        shape, largest = self._shape(nodes), 0.0
        for edges in self._edges:
            ends = nodes[self._cell_nodes[edges.cells][:, list(edges.vertices)]] - shape.apexes[edges.rims][:, None]
            areas = shape.areas[edges.rims]
            sizes = np.maximum(np.linalg.norm(areas, axis=1), np.finfo(float).tiny)
            heights = np.abs(np.einsum("eki,ei->ek", ends, areas)).max(axis=1, initial=0.0) / sizes**1.5
            largest = max(largest, float(heights.max(initial=0.0)))
        return float(self._comm.allreduce(largest, op=MPI.MAX))

    def gradient(self, nodes: Floats) -> Iterator[tuple[Ints, Floats]]:
        """Yield derivatives (m²) of the volume by the nodes of facets' cells on this rank; collective.

        These are numbers of cells (n,) and derivatives by their nodes (n, nodes, 3), to be added up over all pairs.
        """
        shape = self._shape(nodes)
        for facets in self._facets:
            x, at = self._positions(nodes, facets, shape.origin)
            w = facets.signs[:, None, None] * at.weights[:, None] / 3
            vectors = (np.cross(x[1], x[2]), np.cross(x[2], x[0]), np.cross(x[0], x[1]))
            tables = (at.values, *at.slopes)
            yield facets.cells, sum(np.einsum("cpi,pn->cni", w * v, t) for v, t in zip(vectors, tables, strict=True))
        for edges in self._edges:
            x, at = self._positions(nodes, edges, shape.origin)
            w = -edges.signs[:, None, None] * at.weights[:, None] / 6
            c = (shape.apexes[edges.rims] - shape.origin)[:, None, :]
            slope = np.einsum("cpi,pn->cni", w * np.cross(x[1], c), at.values)
            slope += np.einsum("cpi,pn->cni", w * np.cross(c, x[0]), at.slopes[0])
            if self._apex is None:
                apex_slope = shape.areas[edges.rims] / (6 * self._edge_counts[edges.rims, None])
                slope[:, list(edges.vertices)] += apex_slope[:, None, :]
            yield edges.cells, slope

    def _shape(self, nodes: Floats) -> _Shape:
        """Return the cavity with its nodes at ``nodes``; collective."""
        # An origin near the surface keeps the digits of a body far from zero.
        corners = [nodes[self._cell_nodes[f.cells][:, list(f.vertices)]].reshape(-1, 3) for f in self._facets]
        sums = np.array([sum((c.sum(axis=0) for c in corners), np.zeros(3)), [sum(map(len, corners)), 0.0, 0.0]])
        total, (count, *_) = self._comm.allreduce(sums)
        origin = total / count
        volume, areas, apexes = 0.0, np.zeros((self.openings, 3)), np.zeros((self.openings, 3))
        for facets in self._facets:
            x, at = self._positions(nodes, facets, origin)
            volume += float(np.einsum("c,p,cp->", facets.signs, at.weights, np.vecdot(x[0], np.cross(x[1], x[2])))) / 3
        for edges in self._edges:
            x, at = self._positions(nodes, edges, origin)
            np.add.at(areas, edges.rims, -np.einsum("c,p,cpi->ci", edges.signs, at.weights, np.cross(x[0], x[1])) / 2)
            ends = nodes[self._cell_nodes[edges.cells][:, list(edges.vertices)]].mean(axis=1)
            np.add.at(apexes, edges.rims, ends / self._edge_counts[edges.rims, None])
        volume, areas, apexes = (self._comm.allreduce(value) for value in (volume, areas, apexes))
        if self._apex is not None:
            apexes = np.tile(self._apex, (self.openings, 1))
        return _Shape(volume + float(np.vecdot(apexes - origin, areas).sum()) / 3, origin, areas, apexes)

    def _positions(self, nodes: Floats, entities: _Entities, origin: Floats) -> tuple[list[Floats], _Tabulated]:
        """Return positions relative to the origin and their derivatives at points of entities, (cells, points, 3)."""
        at = _on_entity(self._kind, self._degree, entities.vertices)
        x = nodes[self._cell_nodes[entities.cells]] - origin
        return [np.einsum("pn,cni->cpi", table, x) for table in (at.values, *at.slopes)], at

    def _oriented(self, nodes: Floats, cells: Ints, sides: Ints) -> Iterator[_Entities]:
        """Yield the facets on the ``sides`` of cells, by side, with the signs of their orientation."""
        count = vertex_count(self._kind)
        for side, vertices in enumerate(sub_entities(self._kind, 2)):
            here = cells[sides == side]
            corners = nodes[self._cell_nodes[here][:, :count]]
            facet = corners[:, vertices]
            areas = np.cross(facet[:, 1] - facet[:, 0], facet[:, 2] - facet[:, 0])
            inward = np.vecdot(areas, facet.mean(axis=1) - corners.mean(axis=1)) < 0  # out of the cavity
            yield _Entities(here, np.where(inward, 1.0, -1.0), tuple(vertices.tolist()), np.zeros(len(here), np.int64))

    def _rims(self, body: Body) -> tuple[list[_Entities], Ints]:
        """Return the edges around the openings, and their number for each opening; collective."""
        index_map, rows = body.mesh.geometry.index_map(), []
        for facets in self._facets:
            loop = [facets.vertices[i] for i in _LOOPS[len(facets.vertices)]]
            for a, b in zip(loop, [*loop[1:], loop[0]], strict=True):
                ends = np.full((len(facets.cells), 2), (a, b))
                rows.append(np.column_stack([facets.cells, facets.signs.astype(np.int64), ends]))
        edges = np.concatenate(rows)
        nodes = self._cell_nodes[edges[:, :1], edges[:, 2:]].astype(np.int32)
        pairs = np.sort(index_map.local_to_global(nodes.ravel()).reshape(-1, 2), axis=1)
        is_rim = _occur_once(pairs)
        edges, pairs = edges[is_rim], pairs[is_rim]  # of this rank
        all_pairs = self._comm.allgather(pairs)
        first = sum(map(len, all_pairs[: self._comm.rank]))
        together = np.concatenate(all_pairs)
        is_rim = _occur_once(together)
        used, compact = np.unique(together[is_rim], return_inverse=True)
        rims = np.full(len(together), -1)
        rims[is_rim] = np.unique(connected(compact.reshape(-1, 2).astype(np.int64), len(used)), return_inverse=True)[1]
        own = rims[first : first + len(pairs)]
        edges, own = edges[own >= 0], own[own >= 0]
        groups = []
        for ends in np.unique(edges[:, 2:], axis=0):
            here = (edges[:, 2:] == ends).all(axis=1)
            groups.append(_Entities(edges[here, 0], edges[here, 1].astype(float), tuple(ends.tolist()), own[here]))
        return groups, np.bincount(rims[rims >= 0])


def _occur_once(rows: Ints) -> npt.NDArray[np.bool_]:
    """Return the mask of the rows that no other row is equal to."""
    _, place = unique_rows(rows)
    return np.asarray(np.bincount(place, minlength=1)[place] == 1) if len(rows) else np.zeros(0, dtype=bool)
