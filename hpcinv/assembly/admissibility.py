"""Checks of a state of a scene: no element is inverted, and laws are inside their domain."""

from hpcinv.model.outcome import Outcome
from hpcinv.model.quadrature_values import QuadratureValues
from hpcinv.model.scene import Scene


class Admissibility:
    """Checks of the present state at every quadrature point; all of them are collective."""

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
        ranges = [values.range() for values in self._fixed_volumes]
        if any(not (low >= 0.5 and high <= 2) for low, high in ranges):
            return Outcome.VOLUME_CHANGED
        return self.fault()
