"""Quantities of laws, effects and fibres as fields by which results are differentiated: by cell, facet or node.

A number of the job as a field has its own value in each cell, or on each facet of its effect's region. A quantity from
a data array of the mesh has the values of the array.
"""

from __future__ import annotations

from collections.abc import Mapping

import basix
import numpy as np
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.units import Dimension
from hpcinv.job.sensitivities import Parameter, parameter
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.parameters import ParameterDirection
from hpcinv.model.weak_form import WeakForm
from hpcinv.solver.equations import Equations
from hpcinv.trust.sensitivity.point_maps import PointMaps
from hpcinv.trust.sensitivity.variations import Variations


class FieldParameter:
    """A quantity with a value in each cell, for derivatives by these; methods are collective."""

    def __init__(self, direction: ParameterDirection, maps: PointMaps) -> None:
        self._direction, self._maps = direction, maps

    @classmethod
    def of_number(
        cls, number: Parameter, equations: Equations, weak_form: WeakForm, maps: PointMaps, *, by_facet: bool = True
    ) -> FieldParameter:
        """Return a number of a law, an effect or a family of fibres as a field.

        Args:
            by_facet: whether a number of an effect on the surface has values on facets, else in cells.
        """
        owner = number.owner
        assert isinstance(owner, Ingredient)
        direction = weak_form.parameters.direction({number.where: owner.rates(number.place)})
        facets = sorted(owner.surfaces)
        if not (facets and by_facet):
            return cls(direction, maps)
        return FacetParameter(direction, maps, equations, facets)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of its values."""
        return (self._maps.cell_count,)

    def total(self, work: Variations, by_entries: Floats) -> float:
        """Return the derivative by one value in all cells.

        Args:
            by_entries: what `Variations.by_entries` returns.
        """
        mine = float((by_entries @ self._direction.entries).sum())
        for function, rate in self._direction.functions:
            mine += float(work.by_function(function) @ rate.x.array)
        return float(self._maps.comm.allreduce(mine, op=MPI.SUM))

    def gradient(self, work: Variations, by_entries: Floats) -> Floats:
        """Return the derivatives by the values in each cell."""
        mine = by_entries @ self._direction.entries
        for function, rate in self._direction.functions:
            cells = function.function_space.dofmap.list[: len(mine), 0]
            mine = mine + (work.by_function(function) * rate.x.array)[cells]
        return self._maps.by_cell(mine[:, None])[:, 0]

    def along(self, residual: Variations, values: Floats) -> Floats:
        """Return the derivative of the residual along a field, at the local unknowns, before sums over ranks."""
        local = self._maps.of_local_cells(values[:, None])[:, 0]
        forces = residual.along_entries(local[:, None] * self._direction.entries)
        for function, rate in self._direction.functions:
            own = function.copy()
            cells = function.function_space.dofmap.list[:, 0]
            own.x.array[cells] = local * rate.x.array[cells]
            forces = forces + residual.along_function(function, own)
        return forces


class FacetParameter(FieldParameter):
    """A number of an effect with a value on each facet of its regions."""

    def __init__(
        self, direction: ParameterDirection, maps: PointMaps, equations: Equations, regions: list[str]
    ) -> None:
        super().__init__(direction, maps)
        self._facets = Facets(equations, regions, maps)

    @property
    def shape(self) -> tuple[int, ...]:
        return (len(self._facets.vertices),)

    def gradient(self, work: Variations, by_entries: Floats) -> Floats:
        whole = np.zeros(self.shape)
        for facet, values in work.by_entries_of_facets():
            cells, rows = self._facets.of_number(facet)
            whole[rows] += values[cells] @ self._direction.entries
        self._maps.comm.Allreduce(MPI.IN_PLACE, whole, MPI.SUM)
        return whole

    def along(self, residual: Variations, values: Floats) -> Floats:
        forces = np.zeros(0)
        for facet in range(self._facets.count):
            cells, rows = self._facets.of_number(facet)
            local = np.zeros((self._facets.local_cells, len(self._direction.entries)))
            local[cells] = values[rows, None] * self._direction.entries
            part = residual.along_entries_of_facets(facet, local)
            forces = forces + part if len(forces) else part
        return forces


class Facets:
    """The facets of regions of the boundary, in an order that does not depend on the ranks; collective.

    Attributes:
        vertices: numbers of their vertices among the nodes of the mesh, (facets, vertices), in increasing order.
        count: number of facets of a cell.
        local_cells: number of local cells.
    """

    def __init__(self, equations: Equations, regions: list[str], maps: PointMaps) -> None:
        body = equations.body
        mesh, comm = body.mesh, body.mesh.comm
        cells = mesh.topology.index_map(3)
        self.local_cells = cells.size_local + cells.num_ghosts
        facets = np.unique(np.concatenate([body.boundary_facets(name) for name in regions]))
        entities = fem.compute_integration_domains(fem.IntegralType.exterior_facet, mesh.topology, facets)
        self._entities = np.asarray(entities).reshape(-1, 2)
        corners = np.array(basix.topology(mesh.basix_cell())[2])
        self.count = len(corners)
        nodes = body.source_geometry.dofmaps[0][self._entities[:, :1], corners[self._entities[:, 1]]]
        mine = np.sort(maps.numbers[nodes], axis=1)
        self.vertices: Ints = np.unique(np.concatenate(comm.allgather(mine)), axis=0)
        place = {tuple(row): number for number, row in enumerate(self.vertices.tolist())}
        self._rows = np.array([place[tuple(row)] for row in mine.tolist()], dtype=np.int64)

    def of_number(self, facet: int) -> tuple[Ints, Ints]:
        """Return cells with a facet of this local number in the regions, and rows of these among all facets."""
        chosen = self._entities[:, 1] == facet
        return self._entities[chosen, 0], self._rows[chosen]


class ArrayParameter(FieldParameter):
    """A quantity with the values of a data array of the mesh."""

    def __init__(self, function: fem.Function, dimension: Dimension, equations: Equations, maps: PointMaps) -> None:
        self._function, self._maps = function, maps
        self._unit = equations.scales.unit_of(dimension)
        self._width = function.function_space.dofmap.index_map_bs
        self._is_nodal = function.function_space.ufl_element().degree > 0

    @property
    def shape(self) -> tuple[int, ...]:
        count = self._maps.node_count if self._is_nodal else self._maps.cell_count
        return (count,) if self._width == 1 else (count, self._width)

    def gradient(self, work: Variations, by_entries: Floats) -> Floats:
        space = self._function.function_space
        mine = work.by_function(self._function).reshape(-1, self._width) / self._unit
        if self._is_nodal:
            return self._maps.nodal(space, mine).reshape(self.shape)
        owned = space.mesh.topology.index_map(3).size_local
        return self._maps.by_cell(mine[space.dofmap.list[:owned, 0]]).reshape(self.shape)

    def along(self, residual: Variations, values: Floats) -> Floats:
        space, rate = self._function.function_space, self._function.copy()
        given = values.reshape(-1, self._width) / self._unit
        local = self._maps.on_computed_cells(given) if self._is_nodal else self._maps.of_local_cells(given)[:, None]
        rate.x.array.reshape(-1, self._width)[space.dofmap.list] = local
        return residual.along_function(self._function, rate)


def field_parameter(key: str, equations: Equations, weak_form: WeakForm, maps: PointMaps) -> FieldParameter | str:
    """Return the field of a key, such as ``material.mu`` or ``effects[0].pressure``, or what is wrong with it."""
    job = equations.job
    ingredients: Mapping[str, Ingredient] = {
        where: owner for where, owner in job.owners.items() if isinstance(owner, Ingredient)
    }
    for where, owner in ingredients.items():
        for name, (_, dimension) in owner.quantities().items():
            function = weak_form.parameters.function_of(where, name) if key == f"{where}.{name}" else None
            if function is not None and function.function_space.ufl_element().degree <= equations.body.degree:
                return ArrayParameter(function, dimension, equations, maps)
    try:
        number = parameter(key, ingredients, None)
    except ValueError as reason:
        return f"fields: {reason}"
    return FieldParameter.of_number(number, equations, weak_form, maps)
