"""What a leg reports of a scene, compiled once: means over cells, the range of the volume ratio, the strain energy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
from dolfinx import fem

from hpcinv.model.quadrature_values import CellMeans, QuadratureValues
from hpcinv.parallel.jit import JIT_OPTIONS
from hpcinv.parallel.runtime import MPI

if TYPE_CHECKING:
    from hpcinv.model.scene import Scene


class SceneMeans:
    """Evaluates a scene in its present state, on the mesh as it then lies, in scaled units.

    Attributes:
        cauchy_stress: gives the means of the Cauchy stress in each cell, (3, 3).
        J: gives the means of the volume ratio in each cell.
        J_at_points: volume ratio at the quadrature points.
    """

    def __init__(self, scene: Scene) -> None:
        mesh, degree = scene.unknowns.mesh, scene.quadrature_degree
        self.cauchy_stress = CellMeans(scene.cauchy_stress, mesh, degree)
        self.J = CellMeans([(scene.J, None)], mesh, degree)
        self.J_at_points = QuadratureValues(scene.J, mesh, degree)
        self._energy, self._comm = fem.form(scene.strain_energy, jit_options=JIT_OPTIONS), mesh.comm

    def strain_energy(self) -> float:
        """Energy stored in the body; collective."""
        return float(self._comm.allreduce(fem.assemble_scalar(self._energy), op=MPI.SUM))
