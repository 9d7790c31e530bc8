"""Cells and area vectors of facets, and the closed shells of a boundary: the outer one and those around cavities."""

import dolfinx
import numpy as np

from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh.cells import FACET_KIND, sub_entities, vertex_count
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.topology import connected

type Mesh = dolfinx.mesh.Mesh[np.float64]


def cells_of_facets(mesh: Mesh, facets: LocalIndices) -> LocalIndices:
    """Return the cell (n,) of each facet of the boundary (n,), local to this rank."""
    mesh.topology.create_connectivity(2, 3)
    links = mesh.topology.connectivity(2, 3)
    cells: LocalIndices = links.array[links.offsets[facets]]
    return cells


def cells_and_sides(mesh: Mesh, facets: LocalIndices) -> tuple[LocalIndices, Ints]:
    """Return the cell (n,) of each facet of the boundary (n,), and the number (n,) of the facet in it."""
    cells = cells_of_facets(mesh, facets)
    mesh.topology.create_connectivity(3, 2)
    count = len(sub_entities(mesh.topology.cell_type.name, 2))
    sides = mesh.topology.connectivity(3, 2).array.reshape(-1, count)[cells]
    return cells, (sides == facets[:, None]).argmax(axis=1)


def outer_facets(mesh: Mesh, facets: LocalIndices) -> tuple[LocalIndices, Floats]:
    """Geometry nodes (n, k) of the vertices of boundary facets, and their area vectors (n, 3), out of the body.

    Curved facets are taken as flat ones with the same vertices. A quadrilateral whose vertices are in no plane has the
    normal of the plane through the middles of its edges. Not collective.
    """
    kind = mesh.topology.cell_type.name
    count = vertex_count(FACET_KIND[kind])
    if not len(facets):
        return np.zeros((0, count), dtype=np.int32), np.zeros((0, 3))
    nodes = dolfinx.mesh.entities_to_geometry(mesh, 2, facets)[:, :count]
    corners = mesh.geometry.x[nodes]
    if count == 3:
        areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    else:  # vertices of quadrilaterals are numbered row by row
        areas = np.cross(corners[:, 3] - corners[:, 0], corners[:, 2] - corners[:, 1]) / 2
    middles = mesh.geometry.x[mesh.geometry.dofmaps[0][cells_of_facets(mesh, facets)][:, : vertex_count(kind)]].mean(
        axis=1
    )
    areas[np.einsum("ij,ij->i", areas, corners.mean(axis=1) - middles) < 0] *= -1
    return nodes, areas


def cavities(mesh: Mesh, exterior: LocalIndices) -> Ints:
    """For each boundary facet its cavity from 1, the largest first, or 0 if it is on none; collective.

    A cavity is a closed shell whose normals point into it.

    Args:
        exterior: the facets of the boundary on this rank.
    """
    nodes, areas = outer_facets(mesh, exterior)
    # Volume below each facet by the divergence theorem.
    volumes = np.einsum("ij,ij->i", areas, mesh.geometry.x[nodes].mean(axis=1)) / 3
    numbers = mesh.geometry.index_map().local_to_global(nodes.ravel()).reshape(nodes.shape)
    gathered = mesh.comm.gather((numbers, volumes))
    shares = None
    if gathered is not None:
        cavity_numbers = shells(np.concatenate([n for n, _ in gathered]), np.concatenate([v for _, v in gathered]))
        shares = np.split(cavity_numbers, np.cumsum([len(v) for _, v in gathered])[:-1])
    return np.asarray(mesh.comm.scatter(shares))


def shells(facets: Ints, volumes: Floats) -> Ints:
    """Number of the cavity of each facet, 0 on outer surfaces.

    Args:
        facets: vertices (n, k).
        volumes: below each facet, (n,); their sum over a closed shell is negative for a cavity.
    """
    used, compact = np.unique(facets, return_inverse=True)
    compact = compact.reshape(facets.shape).astype(np.int64)
    shell = connected(compact, len(used))
    enclosed = np.bincount(shell, weights=volumes)
    number = np.zeros(len(enclosed), dtype=np.int64)
    inner = np.flatnonzero(enclosed < 0)
    number[inner[np.argsort(enclosed[inner], kind="stable")]] = np.arange(1, len(inner) + 1)
    return np.asarray(number[shell])


SIDES = 7
"""number of values of `facing`"""


def facing(mesh: Mesh) -> Ints:
    """Return for each local node 0 inside, else the axis and sign nearest to the boundary's normal, 1 to 6; collective.

    Nodes that are not vertices count as inside.
    """
    exterior = dolfinx.mesh.exterior_facet_indices(mesh.topology).astype(np.int32)
    corners, areas = outer_facets(mesh, exterior)
    total = dolfinx.la.vector(mesh.geometry.index_map(), 3)
    sums = total.array.reshape(-1, 3)
    for k in range(corners.shape[1]):
        np.add.at(sums, corners[:, k], areas)
    total.scatter_reverse(dolfinx.la.InsertMode.add)
    total.scatter_forward()
    axis = np.abs(sums).argmax(axis=1)
    is_positive = sums[np.arange(len(sums)), axis] > 0
    return np.asarray(np.where(sums.any(axis=1), 1 + 2 * axis + is_positive, 0), dtype=np.int64)
