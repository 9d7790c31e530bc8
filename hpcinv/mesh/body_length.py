"""The length of a body, which depends neither on the axes of the coordinate system nor on its unit."""

import math

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.cells import quadrature, scalar_element
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Floats

_DEGREE = 2  # of the rule of quadrature, exact on straight tetrahedra


def body_length(mesh: Mesh, coordinates: Floats, kind: str, degree: int) -> float:
    """Return ``sqrt(12 ∫|x - c|² dV / V)`` with the centroid c, the diagonal of a cuboid; collective.

    Args:
        coordinates: of the local geometry nodes, (n, 3).
        degree: of the geometry.
    """
    points, weights = quadrature(kind, _DEGREE)
    values, *gradients = scalar_element(kind, degree).tabulate(1, points)[..., 0]
    owned = mesh.topology.index_map(3).size_local
    nodes = coordinates[mesh.geometry.dofmaps[0][:owned]]
    jacobian = np.stack([table @ nodes for table in gradients], axis=-1)
    volumes = np.abs(np.linalg.det(jacobian)) * weights
    x = values @ nodes

    def total(integrand: Floats) -> Floats:
        sums = np.ascontiguousarray(np.tensordot(volumes, integrand, axes=2))
        mesh.comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
        return sums

    volume = float(total(np.ones((*volumes.shape, 1)))[0])
    arms = x - total(x) / volume
    return math.sqrt(12 * float(total((arms**2).sum(axis=-1, keepdims=True))[0]) / volume)
