"""Whether a state of a scene can be one of the body: elements the right way out, laws inside their domain."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hpcinv.model.outcome import Outcome
from hpcinv.model.quadrature_values import QuadratureValues

if TYPE_CHECKING:
    from hpcinv.model.scene import Scene


class Admissibility:
    """Checks at every quadrature point of the present state; all of them are collective."""

    def __init__(self, scene: Scene) -> None:
        mesh, degree = scene.unknowns.mesh, scene.quadrature_degree
        self._mesh_J = QuadratureValues(scene.mesh_J, mesh, degree)
        self._domains = [
            QuadratureValues(value, mesh, degree, part.cells) for part in scene.parts for value in part.domain
        ]
        self._fixed_volumes = [
            QuadratureValues(part.fixed_volume, mesh, degree, part.cells)
            for part in scene.parts
            if part.fixed_volume is not None
        ]

    def min_mesh_J(self) -> float:
        """Smallest determinant of the position map; it must stay positive."""
        return self._mesh_J.range()[0]

    def fault(self) -> Outcome | None:
        """Why the state is not admissible, ``None`` if it is."""
        if not self.min_mesh_J() > 0:
            return Outcome.INVERTED
        if any(not values.range()[0] > 0 for values in self._domains):
            return Outcome.OUTSIDE_LAW
        return None

    def fault_of_solution(self) -> Outcome | None:
        """Why a solution of the discrete equations cannot be one of the continuous ones, ``None`` if it can.

        The discrete constraint holds a volume on average only: a coarse incompressible wall may fold through itself
        with a positive determinant at every quadrature point.
        """
        ranges = [values.range() for values in self._fixed_volumes]
        if any(not (low >= 0.5 and high <= 2) for low, high in ranges):
            return Outcome.VOLUME_CHANGED
        return self.fault()
