"""Projection of values in cells to continuous functions, without solving."""

import numpy as np
from dolfinx import fem, la

from hpcinv.mesh import Body
from hpcinv.mesh.cells import jacobians, scalar_element
from hpcinv.mesh.source import Floats


def projected(body: Body, values: Floats, space: fem.FunctionSpace) -> Floats:
    """Project values (owned cells, components) to linear functions; return them at the owned nodes of ``space``.

    It is the L2 projection with a lumped mass matrix: at each vertex the mean of the cells around it, weighted by their
    volumes in the mesh as it lies. Collective.

    Args:
        space: of scalar Lagrange elements on the mesh of the body.
    """
    mesh = body.mesh
    linear = fem.functionspace(mesh, ("Lagrange", 1))
    owned = mesh.topology.index_map(3).size_local
    corners = linear.dofmap.list[:owned]
    kind, degree = body.source.kind, body.degree
    middle = scalar_element(kind, 1).points.mean(axis=0)[None]
    volumes = np.abs(np.linalg.det(jacobians(kind, degree, mesh.geometry.x[mesh.geometry.dofmaps[0][:owned]], middle)))

    def gathered(cell_values: Floats) -> Floats:
        total = fem.Function(linear)
        np.add.at(total.x.array, corners, np.broadcast_to(cell_values, corners.T.shape).T)
        total.x.scatter_reverse(la.InsertMode.add)
        total.x.scatter_forward()
        return np.asarray(total.x.array)

    weights = gathered(volumes[:, 0])
    size = space.dofmap.index_map.size_local
    nodal_values = np.empty((size, values.shape[1]))
    smooth, nodal = fem.Function(linear), fem.Function(space)
    for column in range(values.shape[1]):
        smooth.x.array[:] = gathered(values[:, column] * volumes[:, 0]) / weights
        nodal.interpolate(smooth)
        nodal_values[:, column] = nodal.x.array[:size]
    return nodal_values
