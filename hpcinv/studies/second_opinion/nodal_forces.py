"""Forces at the nodes that do the work of a uniform load, by the shape functions of the elements."""

from __future__ import annotations

import basix
import numpy as np

from hpcinv.mesh.cells import FACET_KIND, scalar_element
from hpcinv.mesh.refine.degree import centre_weights
from hpcinv.mesh.source import Floats, Ints, MeshSource

_DEGREE = {1: 4, 2: 8}
"""of the quadrature by the degree of the geometry: exact on straight cells, to rounding errors on slightly curved"""


def facet_forces(mesh: MeshSource, points: Floats, facets: Ints, traction: Floats) -> Floats:
    """Return forces (n, 3), N, of a traction (3,), Pa, on facets of nodes (f, k) at ``points`` (n, 3), m."""
    kind = FACET_KIND[mesh.kind]
    shapes, slopes, weights = _tabulated(kind, mesh.degree)
    tangents = np.einsum("dqk,fki->fqdi", slopes, points[facets])
    areas = np.linalg.norm(np.cross(tangents[:, :, 0], tangents[:, :, 1]), axis=2)
    shares = np.einsum("q,fq,qk->fk", weights, areas, shapes)
    return _gathered(mesh, kind, facets, shares, traction)


def cell_forces(mesh: MeshSource, points: Floats, force: Floats) -> Floats:
    """Return forces (n, 3), N, of a force per volume (3,), N/m³, on the cells with nodes at ``points`` (n, 3), m."""
    shapes, slopes, weights = _tabulated(mesh.kind, mesh.degree)
    gradients = np.einsum("dqk,cki->cqdi", slopes, points[mesh.cells])
    shares = np.einsum("q,cq,qk->ck", weights, np.abs(np.linalg.det(gradients)), shapes)
    return _gathered(mesh, mesh.kind, mesh.cells, shares, force)


def _tabulated(kind: str, degree: int) -> tuple[Floats, Floats, Floats]:
    """Return shape functions (q, k), their derivatives (d, q, k) and weights (q,) of a quadrature."""
    places, weights = basix.make_quadrature(basix.CellType[kind], _DEGREE[degree])
    table = scalar_element(kind, degree).tabulate(1, places)[:, :, :, 0]
    return table[0], table[1:], weights


def _gathered(mesh: MeshSource, kind: str, entities: Ints, shares: Floats, load: Floats) -> Floats:
    """Return forces at the nodes; those in faces and cells of hexahedra go to the nodes of elements of 20 nodes."""
    if mesh.degree == 2 and mesh.kind == "hexahedron":
        for node, weights in centre_weights(kind):
            shares += shares[:, [node]] * weights
            shares[:, node] = 0.0
    sums = np.zeros(len(mesh.points))
    np.add.at(sums, entities, shares)
    forces: Floats = sums[:, None] * load
    return forces
