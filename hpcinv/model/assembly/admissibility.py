"""Checks of a state of a weak form: no element is inverted, and laws are inside their domain."""

import numpy as np
import ufl

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.cells import quadrature
from hpcinv.model.outcome import Outcome
from hpcinv.model.quadrature_values import QuadratureValues
from hpcinv.model.weak_form import WeakForm

_SHARE = 1e-3
"""Share of the volume in which a volume ratio is not physical that makes a solution unphysical. Where a coarse wall
folds through itself, it is larger (a sphere: 7e-2; a bent block: 8e-3). With less, single points decide, as at the apex
of a ventricle (2e-4), which stays stable."""


class Admissibility:
    """Checks of the present state at every quadrature point; all of them are collective."""

    def __init__(self, weak_form: WeakForm) -> None:
        mesh, degree = weak_form.unknowns.mesh, weak_form.quadrature_degree
        self._comm, size = mesh.comm, abs(ufl.JacobianDeterminant(mesh))
        self._weights = quadrature(mesh.basix_cell().name, degree)[1]
        self._mesh_J = QuadratureValues(weak_form.mesh_J, mesh, degree)
        self._domains = [
            QuadratureValues(value, mesh, degree, part.cells) for part in weak_form.parts for value in part.domain
        ]
        self._fixed_volumes = [
            QuadratureValues(ufl.as_vector([part.fixed_volume, size]), mesh, degree, part.cells)
            for part in weak_form.parts
            if part.fixed_volume is not None
        ]

    def min_mesh_J(self) -> float:
        """Return the smallest determinant of the position map, which must be positive."""
        return self._mesh_J.range()[0]

    def fault(self) -> Outcome | None:
        """Return the reason why the state is not admissible, ``None`` if it is."""
        if not self.min_mesh_J() > 0:
            return Outcome.INVERTED
        if any(not values.range()[0] > 0 for values in self._domains):
            return Outcome.OUTSIDE_LAW
        return None

    def fault_of_solution(self) -> Outcome | None:
        """Return the reason why a solution of the discrete equations is not physical, ``None`` if it may be.

        The discrete constraint prescribes volumes on average only: a coarse incompressible wall may penetrate itself
        with a positive determinant at every quadrature point.
        """
        changed = np.zeros(2)  # volume that has halved or doubled, and all of it
        for part in self._fixed_volumes:
            for _, values in part:
                ratios, volumes = values[..., 0], values[..., 1] * self._weights
                changed += volumes[~((ratios >= 0.5) & (ratios <= 2))].sum(), volumes.sum()
        self._comm.Allreduce(MPI.IN_PLACE, changed, op=MPI.SUM)
        if changed[0] > _SHARE * changed[1]:
            return Outcome.VOLUME_CHANGED
        return self.fault()
