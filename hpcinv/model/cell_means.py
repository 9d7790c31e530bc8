"""Means over cells, and totals, in the present state; one expression for each part of the body."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh.cells import LayerDegree, layer_interpolation, quadrature
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Floats
from hpcinv.model.quadrature_values import CellMeans, QuadratureValues

_COLUMNS = 10  # components of the stress, and the volume ratio


@dataclass(frozen=True)
class LayerValues:
    """Cauchy stress and volume ratio in the layers of a shell, as the polynomial of their values at its points.

    Attributes:
        degree: of the layer.
        values: at the points of `layer_interpolation`, in each cell (points × 10), piecewise constant.
    """

    degree: LayerDegree
    values: fem.Function

    def weights(self, places: Floats) -> Floats:
        """Return the weights (cells, places, points) of the values for places in cells, (cells, places, 3)."""
        points, weights = layer_interpolation(self.degree, places.reshape(-1, 3))
        return weights.reshape(*places.shape[:2], len(points))

    def scale(self, stress: float) -> None:
        """Multiply the stress by a number."""
        self.values.x.array.reshape(-1, _COLUMNS)[:, :9] *= stress

    def at_points(self, cells: npt.NDArray[np.integer]) -> Floats:
        """Return stress row by row and volume ratio at the points of local cells, (cells, points, 10)."""
        space = self.values.function_space
        values = self.values.x.array.reshape(-1, space.dofmap.bs // _COLUMNS, _COLUMNS)
        return np.asarray(values[space.dofmap.list[cells, 0]])


@dataclass(frozen=True)
class Means:
    """Stresses, volume ratios and energy of a state, in scaled units; functions are piecewise constant.

    Attributes:
        cauchy_stress, J: means in each cell, (3, 3) and scalar.
        J_range: smallest and largest volume ratio at a quadrature point.
        strain_energy: energy stored in the body, stress × length³.
        prestrain_stress: means of the stress that prestrain alone causes, ``None`` without prestrain.
        layer: stress and volume ratio within the layers of a shell, ``None`` in other bodies.
    """

    cauchy_stress: fem.Function
    J: fem.Function
    J_range: tuple[float, float]
    strain_energy: float
    prestrain_stress: fem.Function | None
    layer: LayerValues | None


@dataclass(frozen=True)
class PartExpressions:
    """UFL expressions, in scaled units, to be evaluated in a part of the body.

    Attributes:
        cells: owned cells of the part, ``None`` for all.
        cauchy_stress: (3, 3).
        J: volume ratio.
        energy: stored energy per volume of the mesh.
    """

    cells: LocalIndices | None
    cauchy_stress: Any
    J: Any
    energy: Any


class StateMeans:
    """Stresses, volume ratios and energy in the present state, at the present coordinates of the mesh; collective.

    Args:
        prestrain_stress: the stress that prestrain alone causes, with the cells of each part; empty without prestrain.
    """

    def __init__(
        self,
        parts: Sequence[PartExpressions],
        prestrain_stress: Sequence[tuple[Any, LocalIndices | None]],
        mesh: Mesh,
        quadrature_degree: int,
    ) -> None:
        self._mesh, self._degree = mesh, quadrature_degree
        _, self._weights = quadrature(mesh.basix_cell().name, quadrature_degree)
        volume = abs(ufl.JacobianDeterminant(mesh))
        self._parts = []
        for part in parts:
            sigma = [part.cauchy_stress[index] for index in np.ndindex(3, 3)]
            vector = ufl.as_vector([*sigma, part.J, part.energy, volume])
            self._parts.append(QuadratureValues(vector, mesh, quadrature_degree, part.cells))
        self._prestrain_stress = CellMeans(prestrain_stress, mesh, quadrature_degree) if prestrain_stress else None
        self._spaces = [fem.functionspace(mesh, element) for element in (("DG", 0, (3, 3)), ("DG", 0))]
        self._layer_space = None
        if isinstance(quadrature_degree, LayerDegree):
            points, _ = layer_interpolation(quadrature_degree, np.zeros((1, 3)))
            self._layer_space = fem.functionspace(mesh, ("DG", 0, (_COLUMNS * len(points),)))

    def __call__(self) -> Means:
        sigma, J = map(fem.Function, self._spaces)
        layer, low, high, energy = self._layer(), np.inf, -np.inf, 0.0
        for part in self._parts:
            for cells, values in part:
                volumes = self._weights * values[..., -1]
                sums = np.einsum("cq,cqi->ci", volumes, values[..., :-1])
                means = sums / volumes.sum(axis=1)[:, None]
                for function, columns in ((sigma, means[:, :9]), (J, means[:, 9:10])):
                    dofs = function.function_space.dofmap.list[cells, 0]
                    function.x.array.reshape(-1, columns.shape[1])[dofs] = columns
                if layer is not None:
                    function = layer.values
                    rows = function.x.array.reshape(-1, function.function_space.dofmap.bs)
                    points = values[:, : rows.shape[1] // _COLUMNS, :_COLUMNS]
                    rows[function.function_space.dofmap.list[cells, 0]] = points.reshape(len(cells), -1)
                low, high = min(low, values[..., 9].min()), max(high, values[..., 9].max())
                energy += sums[:, 10].sum()
        for function in (sigma, J, *([layer.values] if layer is not None else [])):
            function.x.scatter_forward()
        comm = self._mesh.comm
        return Means(
            sigma,
            J,
            (float(comm.allreduce(low, op=MPI.MIN)), float(comm.allreduce(high, op=MPI.MAX))),
            float(comm.allreduce(energy, op=MPI.SUM)),
            None if self._prestrain_stress is None else self._prestrain_stress(),
            layer,
        )

    def _layer(self) -> LayerValues | None:
        if self._layer_space is None or not isinstance(self._degree, LayerDegree):
            return None
        return LayerValues(self._degree, fem.Function(self._layer_space))
