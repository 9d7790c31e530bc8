"""Points of one body in the cells of another mesh of it; every rank has all its cells."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.cells import jacobians, kind_and_degree, scalar_element, vertex_count
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Floats, Ints

FARTHEST = 0.5
"""Distance outside a reference cell up to which functions can be extrapolated from it."""
_CHUNK = 20_000  # points, for memory
_NEAR = (24, 240)  # cells with the nearest centres; a point's cell is searched among the first, then among all
_TRIES = 4  # cells of these; reference coordinates are computed in them
_INSIDE = 1e-9  # distance outside the reference cell, by rounding errors
_CURVED = 0.25  # error of that distance if a cell is taken for a linear one
_FAR = 0.1  # the same; above it more cells are looked at
_STEPS, _CONVERGED = 10, 1e-10  # of Newton's method for reference coordinates, and their error
_LOW, _HIGH = -1.0, 2.0  # reference coordinates beyond which a cell is not extrapolated


@dataclass(frozen=True)
class Places:
    """Cells (n,) of points, their reference coordinates (n, 3), and their distance (n,) outside the reference cell."""

    cells: Ints
    xi: Floats
    distance: Floats


class GatheredCells:
    """All cells of a distributed mesh on every rank; made collectively.

    A rank needs about 500 bytes for each cell of second degree, and as much for the values of a function.

    Args:
        scale: factor of the mesh's coordinates.

    Attributes:
        nodes: coordinates (cells, nodes, 3) of their geometry nodes.
    """

    def __init__(self, mesh: Mesh, scale: float = 1.0) -> None:
        self.comm: MPI.Intracomm = mesh.comm
        self.kind, self.degree = kind_and_degree(mesh)
        self._owned = mesh.topology.index_map(3).size_local
        self.nodes = self.gathered(mesh.geometry.x[mesh.geometry.dofmaps[0][: self._owned]] * scale)
        self._middle: Floats = scalar_element(self.kind, 1).points[: vertex_count(self.kind)].mean(axis=0)

    def values(self, function: fem.Function) -> Floats:
        """Return the values (cells, nodes, components) of a function's degrees of freedom in each cell; collective."""
        dofmap = function.function_space.dofmap
        return self.gathered(function.x.array.reshape(-1, dofmap.bs)[dofmap.list[: self._owned]])

    def gathered[T: np.generic](self, cell_values: npt.NDArray[T]) -> npt.NDArray[T]:
        """Return values of all cells from values of the local ones; collective."""
        return np.concatenate(self.comm.allgather(cell_values[: self._owned]))

    def part(self, cells: npt.NDArray[np.bool_]) -> GatheredCells:
        """Return some of the cells by themselves, for `find` and `evaluate`."""
        part = copy(self)
        part.nodes = self.nodes[cells]
        part.__dict__.pop("_linear", None)
        return part

    def find(self, points: Floats) -> Places:
        """Return the places of points (n, 3); those outside all cells are in the nearest one, to be extrapolated.

        Among flat cells a cell next to the point's own may be taken, up to 0.1 of it. Where no cell around a point has
        it, nor nearly, its distance is large, at most infinite.
        """
        cells, xi, distance = np.zeros(len(points), dtype=np.int64), np.empty((len(points), 3)), np.empty(len(points))
        distance[:] = np.inf
        for count in _NEAR:
            missing = np.flatnonzero(distance > _FAR)
            for part in np.array_split(missing, 1 + len(missing) // (_CHUNK * _NEAR[0] // count)):
                cells[part], xi[part], distance[part] = self._find(points[part], min(count, len(self.nodes)))
        return Places(cells, xi, distance)

    def evaluate(self, places: Places, element: Any, values: Floats) -> Floats:
        """Return values (n, components) at places, from `values` of a function with a scalar Basix element."""
        interpolated = np.empty((len(places.cells), values.shape[2]))
        for part in np.array_split(np.arange(len(interpolated)), 1 + len(interpolated) // _CHUNK):
            shapes = element.tabulate(0, places.xi[part])[0].reshape(len(part), values.shape[1])
            interpolated[part] = np.einsum("pn,pni->pi", shapes, values[places.cells[part]])
        return interpolated

    @cached_property
    def _linear(self) -> tuple[Any, Floats, Floats]:
        """Tree of the centres of the cells, the centres, and the inverse Jacobians there."""
        from scipy.spatial import cKDTree  # slow import, needed for nested iteration only

        shapes = scalar_element(self.kind, self.degree).tabulate(0, self._middle[None])[0, 0, :, 0]
        centres = shapes @ self.nodes
        gradients = jacobians(self.kind, self.degree, self.nodes, self._middle[None])[:, 0]
        return cKDTree(centres), centres, np.asarray(np.linalg.inv(gradients), dtype=np.float64)

    def _find(self, points: Floats, count: int) -> tuple[Ints, Floats, Floats]:
        tree, centres, inverse = self._linear
        rows = np.arange(len(points))
        candidates = tree.query(points, count)[1].reshape(len(points), count)
        linear = self._middle + np.einsum("pkij,pkj->pki", inverse[candidates], points[:, None] - centres[candidates])
        estimated = self._distance_outside(linear)
        order = np.argsort(estimated, axis=1)[:, :_TRIES]
        cells, xi, best_distance = (
            candidates[rows, order[:, 0]],
            linear[rows, order[:, 0]],
            np.full(len(points), np.inf),
        )
        for nth in order.T:
            may_be_better = estimated[rows, nth] < best_distance.clip(max=FARTHEST) + _CURVED
            missing = np.flatnonzero((best_distance > _INSIDE) & may_be_better)
            column = nth[missing]
            tried = candidates[missing, column]
            new_xi, distance = self._pulled_back(points[missing], tried, linear[missing, column])
            better = distance < best_distance[missing]
            cells[missing[better]] = tried[better]
            xi[missing[better]], best_distance[missing[better]] = new_xi[better], distance[better]
        return cells, xi, best_distance

    def _pulled_back(self, points: Floats, cells: Ints, xi: Floats) -> tuple[Floats, Floats]:
        """Return reference coordinates of points in cells by Newton's method from ``xi``, and distances outside."""
        element, nodes = scalar_element(self.kind, self.degree), self.nodes[cells]
        xi = xi.clip(_LOW, _HIGH)
        error = np.full(len(points), np.inf)
        for _ in range(_STEPS):
            shapes = element.tabulate(1, xi)[:, :, :, 0]
            position, a, b, c = (shapes.transpose(1, 0, 2) @ nodes).transpose(1, 0, 2)
            # Cramer's rule, which is not an error where a Jacobian is singular, far outside a curved cell.
            adjugate = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                step = (
                    np.einsum("pij,pj->pi", adjugate, points - position)
                    / np.einsum("pi,pi->p", a, adjugate[:, 0])[:, None]
                )
            step = np.nan_to_num(step, posinf=1.0, neginf=-1.0)
            previous, xi = xi, (xi + step).clip(_LOW, _HIGH)
            error = np.abs(xi - previous).max(axis=1)
            if (error <= _CONVERGED).all():
                break
        is_at_end = ((xi == _LOW) | (xi == _HIGH)).any(axis=1)
        return xi, np.where((error <= _CONVERGED) & ~is_at_end, self._distance_outside(xi), np.inf)

    def _distance_outside(self, xi: Floats) -> Floats:
        """Distance (…) of reference coordinates (…, 3) from the reference cell, at most 0 inside."""
        upper = xi.sum(axis=-1) if self.kind == "tetrahedron" else xi.max(axis=-1)
        return np.asarray(np.maximum(-xi.min(axis=-1), upper - 1))
