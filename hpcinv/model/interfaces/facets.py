"""Facets of a surface as polynomials of the nodes of the displacement, with global numbers of the unknowns there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import basix
import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh import Body
from hpcinv.mesh.boundary_shells import cells_and_sides
from hpcinv.mesh.cells import FACET_KIND, scalar_element, sub_entities
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.spaces import Unknowns


@dataclass(frozen=True)
class FacetKind:
    """Triangles or quadrilaterals of a polynomial degree.

    Attributes:
        kind: name of the facet's shape.
    """

    kind: str
    degree: int

    @cached_property
    def corner_count(self) -> int:
        return len(basix.geometry(basix.CellType[self.kind]))

    def values(self, points: Floats) -> Floats:
        """Return basis functions at reference points (n, 2), and their derivatives: (3, n, nodes)."""
        return _tabulated(self.kind, self.degree, points)

    def corner_values(self, points: Floats) -> Floats:
        """Return the basis functions of the corners, of degree 1, at reference points: (n, corners)."""
        return np.asarray(_tabulated(self.kind, 1, points)[0])

    @cached_property
    def middle(self) -> Floats:
        """Reference point in the middle, (1, 2)."""
        return np.asarray(basix.geometry(basix.CellType[self.kind]).mean(axis=0, keepdims=True))

    @cached_property
    def outline(self) -> Ints:
        """Nodes around the facet, with the nodes on its edges, in order."""
        reference = scalar_element(self.kind, self.degree).points
        corners = basix.geometry(basix.CellType[self.kind])
        corners = corners[[0, 1, 2] if len(corners) == 3 else [0, 1, 3, 2]]
        turned = np.roll(corners, -1, axis=0)
        shares = np.arange(self.degree) / self.degree
        points = (corners[:, None] + shares[:, None] * (turned - corners)[:, None]).reshape(-1, 2)
        return np.asarray(np.abs(points[:, None] - reference).max(axis=2).argmin(axis=1))


def _tabulated(kind: str, degree: int, points: Floats) -> Floats:
    table: Floats = scalar_element(kind, degree).tabulate(1, np.ascontiguousarray(points))[:, :, :, 0]
    return table


@dataclass(frozen=True)
class Facets:
    """Facets of one surface; a facet is the polynomial of its nodes of the displacement.

    Attributes:
        kind: their shape.
        nodes: global numbers of the nodes in the space of the displacement, (n, k), corners first.
        unknowns: global numbers of the displacements in the state, (n, k, 3).
        points: positions of the nodes (scaled), (n, k, 3).
        signs: 1 where the normal ``∂x/∂ξ × ∂x/∂η`` points out of the body, else -1, (n,).
    """

    kind: FacetKind
    nodes: Ints
    unknowns: Ints
    points: Floats
    signs: Floats

    def __len__(self) -> int:
        return len(self.nodes)

    @cached_property
    def middles(self) -> Floats:
        """Point and unit normal, out of the body, in the middle of each facet: (2, n, 3)."""
        values = self.kind.values(self.kind.middle)[:, 0]
        place, first, second = np.einsum("dk,nki->dni", values, self.points)
        normal = np.cross(first, second) * self.signs[:, None]
        return np.stack([place, normal / np.linalg.norm(normal, axis=1, keepdims=True)])

    @cached_property
    def radii(self) -> Floats:
        """Largest distance of a node from the middle of its facet, (n,)."""
        return np.asarray(np.linalg.norm(self.points - self.middles[0][:, None], axis=2).max(axis=1, initial=0.0))

    def mean_radius(self, comm: MPI.Intracomm) -> float:
        """Return the mean radius of the facets of all ranks, rounded; collective."""
        total, count = comm.allreduce(float(self.radii.sum())), comm.allreduce(len(self))
        size: float = round(total / max(count, 1), 12)
        return size


class RegionFacets:
    """Owned facets of a region of the boundary: what does not change when the body moves."""

    def __init__(self, body: Body, facets: LocalIndices, unknowns: Unknowns) -> None:
        mesh, cell_kind = body.mesh, body.source.kind
        space = unknowns.displacement_space
        cells, sides = cells_and_sides(mesh, facets)
        owned = cells < mesh.topology.index_map(3).size_local
        cells, sides = cells[owned], sides[owned]
        element = unknowns.scalar_elements[0].basix_element
        self.kind = FacetKind(FACET_KIND[cell_kind], element.degree)
        places, self._signs = _places(cell_kind, element.degree, self.kind.kind)
        self._geometry, self.cells = mesh.geometry, cells
        self._signs = self._signs[sides]
        self._orders = places[sides]
        self._shapes = scalar_element(cell_kind, body.degree).tabulate(0, element.points)[0, :, :, 0]
        dofmap = space.dofmap
        self.local_nodes = np.take_along_axis(dofmap.list[cells], self._orders, axis=1).astype(np.int64)
        self.nodes = _global(dofmap.index_map, self.local_nodes)
        local = unknowns.displacement_dofs_of_nodes[self.local_nodes]
        state, bs = unknowns.space.dofmap.index_map, unknowns.space.dofmap.index_map_bs
        self.unknowns = _global(state, local // bs) * bs + local % bs

    def at(self, geometry_nodes: Floats, u: Floats | None = None) -> Facets:
        """Return the facets where the geometry nodes of the mesh are, plus a displacement (nodes of its space, 3)."""
        nodes = geometry_nodes[self._geometry.dofmaps[0][self.cells]]
        places = np.einsum("ag,cgi->cai", self._shapes, nodes)
        points = np.take_along_axis(places, self._orders[:, :, None], axis=1)
        if u is not None:
            points = points + u[self.local_nodes]
        return Facets(self.kind, self.nodes, self.unknowns, points, self._signs)


def gathered(facets: Facets, comm: object) -> Facets:
    """Return the facets of all ranks on each rank; collective.

    A facet takes 56 bytes for each of its nodes: 100,000 triangles of degree 2 take 34 MB on each rank.
    """
    parts = comm.allgather((facets.nodes, facets.unknowns, facets.points, facets.signs))  # type: ignore[attr-defined]
    nodes, unknowns, points, signs = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Facets(facets.kind, nodes, unknowns, points, signs)


@cache
def _places(cell_kind: str, degree: int, facet_kind: str) -> tuple[Ints, Floats]:
    """Return for each side of a cell the numbers of its nodes, in the order of the facet, and the sign of its normal.

    From degree 3 on the order of nodes within an edge depends on its direction; `displacement` is 1 or 2.
    """
    corners, vertices = sub_entities(cell_kind, 2), basix.geometry(basix.CellType[cell_kind])
    nodes, facet = scalar_element(cell_kind, degree).points, scalar_element(facet_kind, degree).points
    orders, signs = [], []
    for side in corners:
        origin, first, second = vertices[side[:3]]
        points = origin + facet[:, :1] * (first - origin) + facet[:, 1:] * (second - origin)
        orders.append(np.abs(points[:, None] - nodes).max(axis=2).argmin(axis=1))
        normal = np.cross(first - origin, second - origin)
        signs.append(np.sign(normal @ (vertices[side].mean(axis=0) - vertices.mean(axis=0))))
    return np.array(orders), np.array(signs)


def _global(index_map: object, local: Ints) -> Ints:
    flat = index_map.local_to_global(np.ascontiguousarray(local.ravel(), dtype=np.int32))  # type: ignore[attr-defined]
    return np.asarray(flat, dtype=np.int64).reshape(local.shape)
