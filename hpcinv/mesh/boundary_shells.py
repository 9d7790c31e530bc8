"""Outer normals of facets, and the closed shells of a boundary: the outer one and those around cavities."""

from __future__ import annotations

import dolfinx
import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from hpcinv.mesh.cells import FACET_KIND, vertex_count
from hpcinv.mesh.source import Floats, Ints

type LocalIndices = npt.NDArray[np.int32]
type Mesh = dolfinx.mesh.Mesh[np.float64]


def outer_facets(mesh: Mesh, facets: LocalIndices) -> tuple[LocalIndices, Floats]:
    """Geometry nodes (n, k) of the vertices of boundary facets, and their outer unit normals (n, 3); not collective.

    A facet that is not flat has the normal of the plane through the middles of its edges.
    """
    kind = mesh.topology.cell_type.name
    count = vertex_count(FACET_KIND[kind])
    if not len(facets):
        return np.zeros((0, count), dtype=np.int32), np.zeros((0, 3))
    nodes = dolfinx.mesh.entities_to_geometry(mesh, 2, facets)[:, :count]
    corners = mesh.geometry.x[nodes]
    if count == 3:
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    else:  # vertices of quadrilaterals are numbered row by row
        normals = np.cross(corners[:, 3] - corners[:, 0], corners[:, 2] - corners[:, 1])
    to_cells = mesh.topology.connectivity(2, 3)
    cells = to_cells.array[to_cells.offsets[facets]]
    middles = mesh.geometry.x[mesh.geometry.dofmaps[0][cells][:, : vertex_count(kind)]].mean(axis=1)
    inward = np.einsum("ij,ij->i", normals, corners.mean(axis=1) - middles) < 0
    normals[inward] *= -1
    return nodes, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def cavities(mesh: Mesh, exterior: LocalIndices) -> Ints:
    """For each boundary facet its cavity from 1, the largest first, or 0 if it is on none; collective.

    A cavity is a closed shell whose normals point into it.

    Args:
        exterior: the facets of the boundary on this rank.
    """
    nodes, normals = outer_facets(mesh, exterior)
    corners = mesh.geometry.x[nodes]
    if nodes.shape[1] == 3:
        halves = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    else:
        halves = np.cross(corners[:, 3] - corners[:, 0], corners[:, 2] - corners[:, 1])
    # Volume below each facet by the divergence theorem.
    volumes = np.linalg.norm(halves, axis=1) / 2 * np.einsum("ij,ij->i", normals, corners.mean(axis=1)) / 3
    numbers = mesh.geometry.index_map().local_to_global(nodes.ravel()).reshape(nodes.shape)
    gathered = mesh.comm.gather((numbers, volumes))
    shares = None
    if gathered is not None:
        found = shells(np.concatenate([n for n, _ in gathered]), np.concatenate([v for _, v in gathered]))
        shares = np.split(found, np.cumsum([len(v) for _, v in gathered])[:-1])
    return np.asarray(mesh.comm.scatter(shares))


def shells(facets: Ints, volumes: Floats) -> Ints:
    """Number of the cavity of each facet, 0 on outer surfaces.

    Args:
        facets: vertices (n, k).
        volumes: below each facet, (n,), of which the sum over a closed shell is negative for a cavity.
    """
    used, compact = np.unique(facets, return_inverse=True)
    compact = compact.reshape(facets.shape)
    rows, columns = np.repeat(compact[:, 0], facets.shape[1] - 1), compact[:, 1:].ravel()
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(len(used),) * 2)
    count, of_vertex = connected_components(graph, directed=False)
    shell = of_vertex[compact[:, 0]]
    enclosed = np.bincount(shell, weights=volumes, minlength=count)
    number = np.zeros(count, dtype=np.int64)
    inner = np.flatnonzero(enclosed < 0)
    number[inner[np.argsort(enclosed[inner], kind="stable")]] = np.arange(1, len(inner) + 1)
    return np.asarray(number[shell])
