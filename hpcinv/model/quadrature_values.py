"""Values at quadrature points, their means over cells and their range over the body."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh.cells import quadrature
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Floats
from hpcinv.physics.kinematics.staged_derivatives import remove_stages

_CHUNK = 10_000  # cells at a time, so that values at quadrature points take little memory


class CellMeans:
    """Means ``∫ e dV / ∫ dV`` of UFL expressions over each cell.

    Args:
        expressions: scalars, vectors or tensors ``e`` of one shape, each with its cells (``None`` for all).
        quadrature_degree: degree of polynomials whose mean is exact on straight cells.
    """

    def __init__(
        self, expressions: Sequence[tuple[Any, LocalIndices | None]], mesh: Mesh, quadrature_degree: int
    ) -> None:
        self._shape = shape = expressions[0][0].ufl_shape
        self._space = fem.functionspace(mesh, ("DG", 0, shape) if shape else ("DG", 0))
        volume = abs(ufl.JacobianDeterminant(mesh))
        _, self._weights = quadrature(mesh.basix_cell().name, quadrature_degree)
        self._values = []
        for expression, cells in expressions:
            parts = [expression[i] for i in np.ndindex(shape)] if shape else [expression]
            weighted = volume * ufl.as_vector([*parts, 1])
            self._values.append(QuadratureValues(weighted, mesh, quadrature_degree, cells))

    def __call__(self) -> fem.Function:
        """Return the present means, piecewise constant."""
        means = fem.Function(self._space)
        values = means.x.array.reshape(-1, int(np.prod(self._shape)))
        dofs = means.function_space.dofmap.list[:, 0]
        for part in self._values:
            for cells, samples in part:
                sums = np.einsum("q,cqi->ci", self._weights, samples)
                values[dofs[cells]] = sums[:, :-1] / sums[:, -1:]
        means.x.scatter_forward()
        return means


class PointValues:
    """A UFL expression at ``points`` (n, 3) of the reference cell.

    Iteration yields some of the owned cells (or of ``cells``) at a time, with their present values (cells, points, …).
    """

    def __init__(self, expression: Any, mesh: Mesh, points: Floats, cells: LocalIndices | None = None) -> None:
        self._expression = fem.Expression(remove_stages(expression), points, comm=mesh.comm)
        self._mesh = mesh
        owned = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
        self._cells = owned if cells is None else cells

    def __iter__(self) -> Iterator[tuple[npt.NDArray[np.int32], npt.NDArray[np.float64]]]:
        for start in range(0, len(self._cells), _CHUNK):
            cells = self._cells[start : start + _CHUNK]
            yield cells, self._expression.eval(self._mesh, cells)

    def range(self) -> tuple[float, float]:
        """Return the smallest and largest value at any point of any rank; collective."""
        low, high = np.inf, -np.inf
        for _, values in self:
            low, high = np.minimum(low, values.min()), np.maximum(high, values.max())
        comm = self._mesh.comm
        return float(comm.allreduce(low, op=MPI.MIN)), float(comm.allreduce(high, op=MPI.MAX))


class QuadratureValues(PointValues):
    """A UFL expression at the quadrature points of a mesh."""

    def __init__(self, expression: Any, mesh: Mesh, quadrature_degree: int, cells: LocalIndices | None = None) -> None:
        super().__init__(expression, mesh, quadrature(mesh.basix_cell().name, quadrature_degree)[0], cells)
