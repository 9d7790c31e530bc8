"""Extent of a body that is distributed over the ranks: the bounding box of points, and its length."""

import math

import numpy as np
from dolfinx.mesh import Mesh

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.cells import quadrature, scalar_element
from hpcinv.mesh.source import Floats

_DEGREE = 2  # of the rule of quadrature, exact on straight tetrahedra


def extent(comm: MPI.Intracomm, points: Floats) -> tuple[Floats, Floats]:
    """Smallest and largest coordinates of the points (n, 3) of all ranks, ∞ and -∞ if there are none; collective."""
    low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    comm.Allreduce(MPI.IN_PLACE, low, MPI.MIN)
    comm.Allreduce(MPI.IN_PLACE, high, MPI.MAX)
    return low, high


def diagonal(comm: MPI.Intracomm, points: Floats) -> float:
    """Length of the diagonal of the bounding box; collective."""
    low, high = extent(comm, points)
    return float(np.linalg.norm(high - low))


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
