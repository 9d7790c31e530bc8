"""Compiled evaluations of a scene: means over cells, the range of the volume ratio, the strain energy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dolfinx import fem

from hpcinv.model.quadrature_values import CellMeans, QuadratureValues
from hpcinv.parallel.jit import JIT_OPTIONS
from hpcinv.parallel.runtime import MPI

if TYPE_CHECKING:
    from hpcinv.mesh.regions import Mesh
    from hpcinv.model.quadrature_values import Cells


class SceneMeans:
    """Evaluates a scene in its present state, on the mesh as it then lies, in scaled units.

    Attributes:
        cauchy_stress: gives the means of the Cauchy stress in each cell, (3, 3).
        J: gives the means of the volume ratio in each cell.
        J_at_points: volume ratio at the quadrature points.
    """

    def __init__(
        self, mesh: Mesh, degree: int, stress: Sequence[tuple[Any, Cells | None]], J: Any, strain_energy: Any
    ) -> None:
        """Of UFL expressions and the form of the energy; ``degree`` is that of the quadrature."""
        self.cauchy_stress = CellMeans(stress, mesh, degree)
        self.J = CellMeans([(J, None)], mesh, degree)
        self.J_at_points = QuadratureValues(J, mesh, degree)
        self._energy, self._comm = fem.form(strain_energy, jit_options=JIT_OPTIONS), mesh.comm

    def strain_energy(self) -> float:
        """Energy stored in the body; collective."""
        return float(self._comm.allreduce(fem.assemble_scalar(self._energy), op=MPI.SUM))
