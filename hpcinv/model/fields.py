"""Quantities that vary over a body, as functions for forms and as samples for checks."""

from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.spatial_fields import ELSEWHERE, ByData, ByFormula, ByRule, Field
from hpcinv.errors import MeshError, naming_field
from hpcinv.mesh import Body
from hpcinv.mesh.data import as_function, cell_vectors, distribute
from hpcinv.mesh.source import DataArray, Floats
from hpcinv.on_demand import on_demand

_KINDS = {"physical": "groups of the mesh", "geometric": "regions of the job"}
_INWARDS = 0.8  # position of samples from a cell's midpoint to its nodes; formulas may be singular on the surface


class BodyFields:
    """Values of fields on one body, at the coordinates of its mesh at their first evaluation."""

    def __init__(self, body: Body) -> None:
        self.body = body
        self._updated: dict[str, fem.Function] = {}

    def updated(self, name: str, components: int, degree: int) -> fem.Function:
        """Return the function of a name, zero at first, which the solver updates and weak forms share; collective."""
        if name not in self._updated:
            shape = () if components == 1 else (components,)
            space = fem.functionspace(self.body.mesh, ("Lagrange", degree, shape))
            self._updated[name] = fem.Function(space, name=name)
        return self._updated[name]

    def function(self, value: Field, scale: float, where: str) -> fem.Function:
        """Return values in units of ``scale`` (SI), constant in each cell or nodal; collective.

        Raises:
            MeshError: on all ranks, if regions leave gaps or overlap, if there is no such array, or if a rule has no
                direction.
        """
        if isinstance(value, ByRule):
            return self._by_rule(value, where)
        if isinstance(value, ByData):
            function = as_function(self.body, self._array(value))
            function.x.array[:] *= value.factor / scale
            return function
        function = self._regional_function(value, where)
        function.x.array[:] /= scale
        return function

    def _by_rule(self, value: ByRule, where: str) -> fem.Function:
        directions: fem.Function = on_demand("directions of a rule")(self.body, value.rule, where).function
        return directions

    def samples(self, value: float | Field, where: str) -> Floats:
        """Return values (SI) at points inside of each local cell; collective.

        They are to be broadcast to (cells, points), vectors to (cells, points, 3), tensors to (cells, points, 3, 3).
        """
        match value:
            case ByRule():
                return _inwards(cell_vectors(self._by_rule(value, where)))
            case ByData():
                values = self._data(value) * value.factor
                return values.reshape(*values.shape[:2], *{1: (), 3: (3,), 9: (3, 3)}[value.components])
            case ByFormula():
                return formula_values(value, self._points)
            case Field():
                function = self._regional_function(value, where)
                return np.asarray(function.x.array[function.function_space.dofmap.list])
            case number:
                return np.full((1, 1), float(number))

    def vector_samples(self, value: ByData | ByRule | tuple[ByFormula, ...], where: str) -> Floats:
        """Return vectors as `samples`, (cells, points, 3) after broadcasting; collective."""
        if isinstance(value, Field):
            return self.samples(value, where)
        stacked: Floats = np.stack(np.broadcast_arrays(*(self.samples(v, where) for v in value)), axis=2)
        return stacked

    def _array(self, value: ByData) -> DataArray:
        array = distribute(self.body, value.array)
        if (count := array.values.shape[1]) != value.components:
            raise MeshError(
                f"{self.body.source.path}: the array '{value.array}' has {count} components, not {value.components}",
                "A parameter is an array of one component, a direction one of three, a tensor one of nine.",
            )
        return array

    def _data(self, value: ByData) -> Floats:
        array = self._array(value)
        if array.place == "cells":
            return array.values[:, None, :]
        return _inwards(array.values[self._nodes])

    @property
    def _nodes(self) -> npt.NDArray[np.int32]:
        return np.asarray(self.body.mesh.geometry.dofmaps[0])

    @cached_property
    def _points(self) -> Floats:
        return _inwards(self.body.given_nodes[self._nodes])

    def _regional_function(self, value: Field, where: str) -> fem.Function:
        """Return values (SI), constant in each cell."""
        number = parts(self.body, value.numbers, where)
        function = fem.Function(fem.functionspace(self.body.mesh, ("DG", 0)))
        function.x.array[function.function_space.dofmap.list[:, 0]] = np.array([*value.numbers.values(), np.nan])[
            number
        ]
        function.x.scatter_forward()  # only the owner of a ghost is sure to have its region
        return function


def formula_values(value: ByFormula, points: Floats) -> Floats:
    """Return values (…) of a formula at points (…, 3) in m of the body on which it is given."""
    x, y, z = np.moveaxis(points, -1, 0)
    return np.broadcast_to(value.values_at({"x": x, "y": y, "z": z, "X": x, "Y": y, "Z": z}), x.shape)


def law_cells(body: Body, laws: Mapping[str, Any]) -> tuple[npt.NDArray[np.int32], ...]:
    """Return owned cells of each law's region, in the order of the job; empty if one law holds for the whole body.

    Raises:
        MeshError: on all ranks, if a cell is in no region or in two.
    """
    if "material" in laws:
        return ()
    number = parts(body, [name.removeprefix("material.") for name in laws], "material")
    owned = number[: body.mesh.topology.index_map(3).size_local]
    return tuple(np.flatnonzero(owned == i).astype(np.int32) for i in range(len(laws)))


def parts(body: Body, names: Iterable[str] | Mapping[str, Any], where: str) -> npt.NDArray[np.int64]:
    """Return the index in ``names`` of the region of each local cell (correct for owned cells); collective.

    Regions of the job ('regions') take their cells from the groups of the mesh; ``elsewhere`` are the cells in none of
    the others.

    Raises:
        MeshError: on all ranks, if a cell is in no region, in two groups of the mesh or in two regions of the job, or
            if no cell is left to a group.
    """
    cells = body.mesh.topology.index_map(3)
    owned = cells.size_local
    number = np.full(owned + cells.num_ghosts, -1)
    groups: dict[str, list[tuple[int, str]]] = {"physical": [], "geometric": []}
    for i, name in enumerate(names):
        if name != ELSEWHERE:
            with naming_field(where):
                body.cells(name)  # raises an error for unknown and empty regions
            groups["physical" if body.regions[name].origin == "physical" else "geometric"].append((i, name))
    for origin, members in groups.items():
        members_there = np.full_like(number, -1)
        for i, name in members:
            mine = body.cells(name)
            taken = members_there[mine[mine < owned]]
            if body.mesh.comm.allreduce(bool((taken >= 0).any()), op=MPI.LOR):
                other = body.mesh.comm.allreduce(int(taken.max(initial=-1)), op=MPI.MAX)
                raise MeshError(
                    f"{body.source.path}: {where}: some cells are in '{name}' and in '{list(names)[other]}',"
                    f" which are both {_KINDS[origin]}",
                    "Let every cell be in one of these only. A region of the job takes its cells from groups of the"
                    " mesh.",
                )
            members_there[mine] = i
        number = np.where(members_there >= 0, members_there, number)
    for i, name in groups["physical"]:
        if not body.mesh.comm.allreduce(int(np.count_nonzero(number[:owned] == i)), op=MPI.SUM):
            raise MeshError(
                f"{body.source.path}: {where}: the regions of the job leave no cell of the group '{name}'",
                "Remove the group here, or let the conditions in 'regions' hold in fewer cells.",
            )
    rest = list(names).index(ELSEWHERE) if ELSEWHERE in names else -1
    number[number < 0] = rest
    if missing := body.mesh.comm.allreduce(int(np.count_nonzero(number[:owned] < 0)), op=MPI.SUM):
        raise MeshError(
            f"{body.source.path}: {where}: {missing} cells are in none of its regions ({', '.join(names)})",
            f"Add their region, or a value for '{ELSEWHERE}'.",
        )
    return number


def _inwards(nodal: Floats) -> Floats:
    """Return values at points inside of cells from nodal values, (cells, nodes, components)."""
    middle = nodal.mean(axis=1, keepdims=True)
    inner: Floats = middle + _INWARDS * (nodal - middle)
    return inner
