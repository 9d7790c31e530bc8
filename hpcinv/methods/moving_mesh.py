"""A mesh whose nodes can be moved to the present estimate of the reference body."""

from contextlib import AbstractContextManager

import numpy as np
import ufl
from dolfinx import fem

from hpcinv.mesh.bounding_box import diagonal
from hpcinv.mesh.moved import placed
from hpcinv.mesh.source import Floats
from hpcinv.model.quadrature_values import QuadratureValues
from hpcinv.model.spaces import Unknowns
from hpcinv.parallel.runtime import MPI


class MovableMesh:
    """Geometry nodes of a mesh, and the displacement at these nodes.

    A body is an array ``X`` of the positions of the local nodes, (n, 3) in scaled lengths, ghosts included.
    """

    def __init__(self, unknowns: Unknowns, quadrature_degree: int) -> None:
        self.unknowns, self.mesh = unknowns, unknowns.mesh
        geometry = self.mesh.geometry
        self.given: Floats = geometry.x.copy()
        self._owned = slice(geometry.index_map().size_local)
        self._nodal = fem.Function(unknowns.nodal_space)
        self._dof_of_node = np.empty(len(self.given), dtype=np.int32)
        self._dof_of_node[geometry.dofmaps[0]] = self._nodal.function_space.dofmap.list
        self._jacobian = QuadratureValues(ufl.JacobianDeterminant(self.mesh), self.mesh, quadrature_degree)
        self._given_jacobian = self._jacobians(self.given)

    def at(self, X: Floats) -> AbstractContextManager[None]:
        """Context in which the mesh lies at ``X``; afterwards its coordinates are restored exactly."""
        return placed(self.mesh, X)

    def displacement(self) -> Floats:
        """Return the displacement of the present state at the nodes, the same on all ranks that share a node."""
        return self.unknowns.at_nodes(self.unknowns.displacement())

    def correct_displacement(self, change: Floats) -> None:
        """Add a field of the geometry's degree, given at the nodes, to the displacement of the present state."""
        self._nodal.x.array.reshape(-1, 3)[self._dof_of_node] = change
        u = fem.Function(self.unknowns.displacement_space)
        u.interpolate(self._nodal)
        u.x.scatter_forward()
        u.x.array[:] += self.unknowns.displacement().x.array
        self.unknowns.set_displacement(u)

    def least_volume_ratio(self, X: Floats, of: Floats | None = None) -> float:
        """Return the smallest volume of body ``X`` per volume of another (by default the given one) at any point."""
        before = self._given_jacobian if of is None else self._jacobians(of)
        least = float((self._jacobians(X) / before).min(initial=np.inf))
        return float(self.mesh.comm.allreduce(least, op=MPI.MIN))

    def inner(self, a: Floats, b: Floats) -> float:
        """Return ``Σ a·b`` over all nodes of all ranks."""
        return float(self.mesh.comm.allreduce(float(np.vdot(a[self._owned], b[self._owned])), op=MPI.SUM))

    def largest(self, vectors: Floats) -> float:
        """Return the largest length of a nodal vector over all ranks; not finite if one is not."""
        longest = float(np.linalg.norm(vectors, axis=1).max(initial=0.0))
        return float(self.mesh.comm.allreduce(longest, op=MPI.MAX))

    @property
    def diagonal(self) -> float:
        """Diagonal of the given body's bounding box, in scaled lengths."""
        return diagonal(self.mesh.comm, self.given)

    def _jacobians(self, X: Floats) -> Floats:
        """Return Jacobian determinants of body ``X`` at the quadrature points of the owned cells."""
        with self.at(X):
            values = [v.ravel() for _, v in self._jacobian]
        return np.concatenate([np.empty(0), *values])
