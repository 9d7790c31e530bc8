"""Derivatives of a form of the state by what it depends on: unknowns, parameters in each cell, fields, and nodes.

Parameters are entries of one constant of the weak form (`hpcinv.model.parameters`). Here a function that is constant in
each cell takes its place, so that one assembly has the derivatives by all parameters in all cells. The mesh moves by a
function of its nodes, which is zero (`hpcinv.physics.kinematics.mesh_motion`). UFL and the point programs
differentiate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem

from hpcinv.mesh.source import Floats
from hpcinv.model.weak_form import WeakForm
from hpcinv.physics.kinematics.mesh_motion import on_moved_mesh


class Variations:
    """A form without arguments, or one that is linear in the test functions of a weak form, and its derivatives.

    Results are of this rank's cells alone, at local degrees of freedom, before sums over ranks.

    Args:
        form: of the state, the parameters and the functions of ``weak_form``.
        weight: a function that takes the place of the test functions.
    """

    def __init__(self, form: Any, weak_form: WeakForm, weight: fem.Function | None = None) -> None:
        self._weak_form, self._given = weak_form, form
        self._replaced: dict[Any, Any] = {} if weight is None else {weak_form.unknowns.test: weight}
        self._mesh = weak_form.unknowns.mesh
        self._known: dict[Any, fem.Form] = {}
        self._on_facets: dict[str, Any] = {}  # compiled, for facets of all local numbers
        self._rates: dict[fem.Function, fem.Function] = {}

    @cached_property
    def _entries(self) -> fem.Function:
        """The parameters of each cell."""
        count = self._weak_form.parameters.constant.value.size
        element = basix.ufl.element("DG", self._mesh.basix_cell(), 0, shape=(count,))
        return fem.Function(fem.functionspace(self._mesh, element))

    @cached_property
    def _entry_rates(self) -> fem.Function:
        return fem.Function(self._entries.function_space)

    @cached_property
    def motion(self) -> fem.Function:
        """The motion of the nodes of the computed cells (scaled), which is zero."""
        return fem.Function(self._weak_form.unknowns.nodal_space)

    @cached_property
    def _motion_rate(self) -> fem.Function:
        return fem.Function(self._weak_form.unknowns.nodal_space)

    @cached_property
    def _form(self) -> Any:
        return ufl.replace(self._given, self._replaced) if self._replaced else self._given

    @cached_property
    def _with_entries(self) -> Any:
        return ufl.replace(self._given, {**self._replaced, self._weak_form.parameters.constant: self._entries})

    def value(self) -> float:
        """Return the part of this rank's cells of a form without arguments."""
        return float(self._values("value", lambda: _weighted(self._form, self._mesh)).sum())

    def by_state(self) -> Floats:
        """Return the derivative of a number by the unknowns."""
        unknowns = self._weak_form.unknowns
        return self._values("state", lambda: ufl.derivative(self._form, unknowns.state, unknowns.test))

    def by_entries(self) -> Floats:
        """Return the derivatives (owned cells, entries) of a number by the parameters in each cell."""
        self._set_entries()
        values = self._values("entries", lambda: self._by_entries(self._with_entries))
        return self._of_cells(values)

    def by_entries_of_facets(self) -> Iterator[tuple[int, Floats]]:
        """Yield local numbers of facets, and what they alone add to `by_entries` through integrals over the surface."""
        if not self._on_surface:
            return
        self._set_entries()
        for facet in range(len(basix.topology(self._mesh.basix_cell())[2])):
            yield facet, self._of_cells(self._facet_values("entries", facet, self._by_entries))

    @cached_property
    def _on_surface(self) -> list[Any]:
        return [i for i in self._with_entries.integrals() if i.integral_type() == "exterior_facet"]

    def _by_entries(self, form: Any) -> Any:
        return ufl.derivative(form, self._entries, ufl.TestFunction(self._entries.function_space))

    def by_function(self, function: fem.Function) -> Floats:
        """Return the derivative of a number by the values of a function of the parameters."""
        test = ufl.TestFunction(function.function_space)
        return self._values(("function", function), lambda: ufl.derivative(self._form, function, test))

    def by_nodes(self) -> Floats:
        """Return the derivative of a number by the positions (scaled) of the nodes of `motion`."""
        test = ufl.TestFunction(self.motion.function_space)
        moved = self._values("nodes", lambda: ufl.derivative(on_moved_mesh(self._form, self.motion), self.motion, test))
        return moved.reshape(-1, 3)

    def along_entries(self, rates: Floats) -> Floats:
        """Return the derivative of a form linear in test functions along rates (local cells, entries) of parameters."""
        self._set_entries()
        self._set_rates(rates)
        return self._values(
            "along entries", lambda: ufl.derivative(self._with_entries, self._entries, self._entry_rates)
        )

    def along_entries_of_facets(self, facet: int, rates: Floats) -> Floats:
        """Return what integrals over facets of one local number add to `along_entries`."""
        if not self._on_surface:
            return np.zeros(len(self._weak_form.unknowns.state.x.array))
        self._set_entries()
        self._set_rates(rates)
        return self._facet_values(
            "along entries", facet, lambda form: ufl.derivative(form, self._entries, self._entry_rates)
        )

    def along_function(self, function: fem.Function, rate: fem.Function) -> Floats:
        """Return the derivative of a form linear in test functions along the rate of a function."""
        if function not in self._rates:
            self._rates[function] = fem.Function(function.function_space)
        kept = self._rates[function]
        kept.x.array[:] = rate.x.array
        return self._values(("along function", function), lambda: ufl.derivative(self._form, function, kept))

    def along_motion(self, rates: Floats) -> Floats:
        """Return the derivative of a form linear in test functions along rates of the positions (scaled) of nodes.

        Args:
            rates: (n, 3) at the local degrees of freedom of `motion`.
        """
        self._motion_rate.x.array[:] = rates.ravel()
        return self._values(
            "along motion",
            lambda: ufl.derivative(on_moved_mesh(self._form, self.motion), self.motion, self._motion_rate),
        )

    def _set_rates(self, rates: Floats) -> None:
        dofs = self._entries.function_space.dofmap.list[:, 0]
        self._entry_rates.x.array.reshape(-1, rates.shape[1])[dofs] = rates

    def _set_entries(self) -> None:
        values = self._weak_form.parameters.constant.value
        self._entries.x.array.reshape(-1, len(values))[:] = values

    def _of_cells(self, values: Floats) -> Floats:
        count = self._weak_form.parameters.constant.value.size
        cells = self._mesh.topology.index_map(3).size_local
        return np.asarray(values.reshape(-1, count)[self._entries.function_space.dofmap.list[:cells, 0]])

    def _values(self, key: Any, form: Any) -> Floats:
        """Assemble a form of rank 1, which is made if it is not known."""
        if key not in self._known:
            self._known[key] = fem.form(form())
        return _assembled(self._known[key])

    def _facet_values(self, key: str, facet: int, derivative: Callable[[Any], Any]) -> Floats:
        """Assemble a derivative of the integrals over the surface, on facets of one local number."""
        if (key, facet) not in self._known:
            if key not in self._on_facets:
                form = derivative(ufl.Form(self._on_surface))
                self._on_facets[key] = fem.compile_form(self._mesh.comm, form)
            self._known[key, facet] = self._facet_form(self._on_facets[key], facet)
        return _assembled(self._known[key, facet])

    def _facet_form(self, compiled: Any, facet: int) -> fem.Form:
        form, numbers = compiled.ufl_form, {i.subdomain_id() for i in self._on_surface}
        regions = {number: entities for i in self._on_surface for number, entities in i.subdomain_data()}
        pairs = [(n, _of_facet(entities, facet)) for n, entities in regions.items() if n in numbers]
        return fem.create_form(
            compiled,
            [argument.ufl_function_space() for argument in form.arguments()],
            self._mesh,
            {fem.IntegralType.exterior_facet: pairs},
            {function: function for function in form.coefficients()},
            {constant: constant for constant in form.constants()},
        )


def _assembled(made: fem.Form) -> Floats:
    """Return this rank's part of a vector, at local degrees of freedom."""
    spaces = made.function_spaces[0].dofmap
    result = np.zeros(spaces.index_map_bs * (spaces.index_map.size_local + spaces.index_map.num_ghosts))
    fem.assemble_vector(result, made)
    return result


def _weighted(form: Any, mesh: Any) -> Any:
    """Return a number as a vector over cells, which programs assemble."""
    weight = ufl.TestFunction(fem.functionspace(mesh, ("DG", 0)))
    return ufl.Form([part.reconstruct(integrand=part.integrand() * weight) for part in form.integrals()])


def _of_facet(entities: Any, facet: int) -> Any:
    pairs = np.asarray(entities).reshape(-1, 2)
    return np.ascontiguousarray(pairs[pairs[:, 1] == facet].ravel())
