"""Vertices of a mesh at given points, and edges between them."""

import dolfinx
import numpy as np

from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh.boundary_shells import Mesh
from hpcinv.mesh.extent import extent
from hpcinv.mesh.source import Floats

_NEAR = 1e-3
"""Distance of a vertex from a point, relative to the body, up to which it is meant; raised, points may be less exact"""


def vertices_at(mesh: Mesh, points: Floats) -> tuple[LocalIndices, LocalIndices, Floats]:
    """Return the `nearest_vertices` to points (n, 3), the edges between them, and where too far; collective."""
    vertices, far = nearest_vertices(mesh, points)
    return vertices, edges_between(mesh, vertices), far


def nearest_vertices(mesh: Mesh, points: Floats) -> tuple[LocalIndices, Floats]:
    """Return the vertices of this rank, also ghosts, that are nearest to points (n, 3); collective.

    Returns:
        The vertices, and for each point the nearest vertex (n, 3) if it is too far, else NaN.
    """
    topology = mesh.topology
    for pair in ((0, 3), (3, 0)):
        topology.create_connectivity(*pair)
    count = topology.index_map(0).size_local + topology.index_map(0).num_ghosts
    vertices = np.arange(count, dtype=np.int32)
    nodes = dolfinx.mesh.entities_to_geometry(mesh, 0, vertices).ravel()
    places, numbers = mesh.geometry.x[nodes], np.asarray(mesh.geometry.input_global_indices)[nodes]
    low, high = extent(mesh.comm, mesh.geometry.x)
    near = _NEAR * float(np.linalg.norm(high - low))
    chosen, far = list[LocalIndices](), np.full((len(points), 3), np.nan)
    for row, point in enumerate(points):
        distances = np.linalg.norm(places - point, axis=1)
        # The number decides between equal distances, the same on any number of ranks.
        best = None
        if count:
            nearest = np.flatnonzero(distances == distances.min())
            i = nearest[numbers[nearest].argmin()]
            best = float(distances[i]), int(numbers[i]), places[i].tolist()
        distance, number, place = min(found for found in mesh.comm.allgather(best) if found is not None)
        if distance > near:
            far[row] = place
        else:
            chosen.append(vertices[numbers == number])
    return np.unique(np.concatenate([vertices[:0], *chosen])), far


def edges_between(mesh: Mesh, vertices: LocalIndices) -> LocalIndices:
    """Return the edges of this rank, also ghosts, both of whose ends are among these vertices; collective."""
    topology = mesh.topology
    topology.create_entities(1)
    for pair in ((1, 0), (1, 3)):
        topology.create_connectivity(*pair)
    ends = topology.connectivity(1, 0).array.reshape(-1, 2)
    return np.flatnonzero(np.isin(ends, vertices).all(axis=1)).astype(np.int32)
