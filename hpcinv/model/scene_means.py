"""Means over cells and totals of a scene in its present state, of one compiled expression for each part of the body."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from hpcinv.mesh.cells import quadrature
from hpcinv.mesh.regions import Mesh
from hpcinv.model.quadrature_values import CellMeans, CellNumbers, QuadratureValues
from hpcinv.parallel.runtime import MPI


@dataclass(frozen=True)
class Means:
    """What a state is reported by, in scaled units; functions are piecewise constant.

    Attributes:
        cauchy_stress, J: means in each cell, (3, 3) and scalar.
        J_range: smallest and largest volume ratio at a quadrature point.
        strain_energy: energy stored in the body, stress × length³.
        prestrain_stress: means of the stress that prestrain alone causes, ``None`` without prestrain.
    """

    cauchy_stress: fem.Function
    J: fem.Function
    J_range: tuple[float, float]
    strain_energy: float
    prestrain_stress: fem.Function | None


@dataclass(frozen=True)
class PartExpressions:
    """What is evaluated in a part of the body, as UFL expressions in scaled units.

    Attributes:
        cells: owned cells of the part, ``None`` for all.
        cauchy_stress: (3, 3).
        J: volume ratio.
        energy: stored energy per volume of the mesh.
    """

    cells: CellNumbers | None
    cauchy_stress: Any
    J: Any
    energy: Any


class SceneMeans:
    """Evaluations of a scene in its present state, at the present coordinates of the mesh; collective.

    Args:
        prestrain_stress: the stress that prestrain alone causes, with the cells of each part; empty without prestrain.
    """

    def __init__(
        self,
        parts: Sequence[PartExpressions],
        prestrain_stress: Sequence[tuple[Any, CellNumbers | None]],
        mesh: Mesh,
        quadrature_degree: int,
    ) -> None:
        self._mesh = mesh
        _, self._weights = quadrature(mesh.basix_cell().name, quadrature_degree)
        volume = abs(ufl.JacobianDeterminant(mesh))
        self._parts = []
        for part in parts:
            sigma = [part.cauchy_stress[index] for index in np.ndindex(3, 3)]
            vector = ufl.as_vector([*sigma, part.J, part.energy, volume])
            self._parts.append(QuadratureValues(vector, mesh, quadrature_degree, part.cells))
        self._prestrain_stress = CellMeans(prestrain_stress, mesh, quadrature_degree) if prestrain_stress else None

    def __call__(self) -> Means:
        sigma = fem.Function(fem.functionspace(self._mesh, ("DG", 0, (3, 3))))
        J = fem.Function(fem.functionspace(self._mesh, ("DG", 0)))
        low, high, energy = np.inf, -np.inf, 0.0
        for part in self._parts:
            for cells, values in part:
                volumes = self._weights * values[..., -1]
                sums = np.einsum("cq,cqi->ci", volumes, values[..., :-1])
                means = sums / volumes.sum(axis=1)[:, None]
                for function, columns in ((sigma, means[:, :9]), (J, means[:, 9:10])):
                    dofs = function.function_space.dofmap.list[cells, 0]
                    function.x.array.reshape(-1, columns.shape[1])[dofs] = columns
                low, high = min(low, values[..., 9].min()), max(high, values[..., 9].max())
                energy += sums[:, 10].sum()
        for function in (sigma, J):
            function.x.scatter_forward()
        comm = self._mesh.comm
        return Means(
            sigma,
            J,
            (float(comm.allreduce(low, op=MPI.MIN)), float(comm.allreduce(high, op=MPI.MAX))),
            float(comm.allreduce(energy, op=MPI.SUM)),
            None if self._prestrain_stress is None else self._prestrain_stress(),
        )
