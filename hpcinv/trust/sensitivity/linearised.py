"""A job's equations at its solution, with what products with their derivatives need: maps, fields, quantities."""

from __future__ import annotations

from functools import cached_property, partial
from typing import Any
from weakref import ref

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError
from hpcinv.job.combinations import HISTORY, has_history
from hpcinv.job.job import Job
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.job.sensitivities import Parameter
from hpcinv.job.support import Support
from hpcinv.mesh.cells import LayerDegree
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.on_demand import on_demand
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.trust.sensitivity.analysis import moves_nodes, node_rates
from hpcinv.trust.sensitivity.field_parameters import FieldParameter, field_parameter
from hpcinv.trust.sensitivity.point_maps import PointMaps
from hpcinv.trust.sensitivity.quantity_covectors import PointSlopes, point_slopes, refusal_of
from hpcinv.trust.sensitivity.quantity_forms import QuantityForm
from hpcinv.trust.sensitivity.variations import Variations

SHAPE, NODES = "shape", "nodes"


class SupportRates:
    """Rates of the displacements (scaled) that supports prescribe, on the given mesh at full load; collective."""

    def __init__(self, equations: Equations, solution: Solution) -> None:
        self._equations, self._direction = equations, solution.direction
        self._supports, self._unknowns = equations.supports, equations.unknowns
        self._owned = self._unknowns.space.dofmap.index_map.size_local * self._unknowns.space.dofmap.index_map_bs

    def by_number(self, parameter: Parameter, by_held: Floats) -> float:
        """Return the derivative by a number of a support, from derivatives by the held local unknowns."""
        rates = self.rates(parameter)[: self._owned]
        return float(self._equations.body.mesh.comm.allreduce(float(by_held[: self._owned] @ rates), op=MPI.SUM))

    def rates(self, parameter: Parameter) -> Floats:
        """Return rates of the held local unknowns by a number of a support, zero at others."""
        owner = parameter.owner
        assert isinstance(owner, Support)
        number = self._equations.job.supports.index(owner)
        replaced = partial(owner.number_replaced, parameter.place)
        return self._on_state(self._supports.rates(number, replaced, parameter.value, self._direction))

    def by_nodes(self, by_held: Floats, maps: PointMaps) -> Floats:
        """Return the derivative (N, 3) by positions (m) of the mesh's nodes, from derivatives by held unknowns."""
        slopes = self._slopes()
        count = len(self._equations.body.source_geometry.x)
        if slopes is None:
            return np.zeros((maps.node_count, 3))
        held = by_held.copy()
        held[self._owned :] = 0.0
        dofs = self._unknowns.displacement_dofs_of_nodes
        at_points = np.zeros((len(dofs), 3))
        for axis, of_axis in enumerate(slopes):
            at_points[:, axis] = (held * of_axis)[dofs].sum(axis=1)
        return maps.summed(maps.positions.at_nodes(at_points[maps.positions.points], count))

    def along_nodes(self, moved: Floats, maps: PointMaps) -> Floats:
        """Return rates of the held local unknowns along rates (m) of the local nodes of the mesh, (n, 3)."""
        slopes, dofs = self._slopes(), self._unknowns.displacement_dofs_of_nodes
        rates = np.zeros(len(self._unknowns.state.x.array))
        if slopes is None:
            return rates
        positions = np.zeros((len(dofs), 3))
        positions[maps.positions.points] = maps.positions.at_points(moved)
        for axis, of_axis in enumerate(slopes):
            rates[dofs] += of_axis[dofs] * positions[:, axis, None]
        return rates

    def _slopes(self) -> list[Floats] | None:
        """Return derivatives of the held local unknowns (scaled) by each coordinate (m) of their points."""
        if not self._supports.prescribe_motion:
            return None
        return [self._on_state(self._supports.position_rates(axis, self._equations.job)) for axis in range(3)]

    def _on_state(self, rates: list[Floats]) -> Floats:
        values = np.zeros(len(self._unknowns.state.x.array))
        for entry, entry_rates in zip(self._supports.prescribed, rates, strict=True):
            values[entry.dofs] = entry_rates[entry.nodes]
        return values


def refusal(job: Job, solution: Solution) -> str:
    """Return why a solution has no derivatives by products; empty if it has."""
    if job.states:
        return "jobs with 'states' are not supported; run the states one by one"
    if not job.has_derivatives or len(job.all_interfaces) > len(job.interfaces):
        return "bodies in contact with a rigid obstacle are not supported"
    if has_history(job):
        return f"friction {HISTORY}"
    if solution.constraints:
        return "jobs with unknown numbers of loads or supports are not supported; give these numbers"
    return ""


class Linearised:
    """A job's equations, put into its first solution."""

    def __init__(self, equations: Equations, solution: Solution, job: Job, caller: str) -> None:
        self._caller, self._job = caller, job
        if reason := refusal(job, solution):
            raise self._error(reason)
        self._equations, self._solution = equations, solution
        equations.put(solution)
        self._weak_form = equations.weak_form(solution.direction)
        self._unknowns, self._length = equations.unknowns, equations.scales.length
        self.maps: PointMaps = self._kept("maps", lambda: PointMaps(equations.body, equations.unknowns))
        self._comm = self.maps.comm
        self._parameters = [p for p in job.differentiated if p.where in job.owners or moves_nodes(p, job)]
        self._quantities = {q.name: q for q in job.quantities}

    def _kept(self, name: str, make: Any) -> Any:
        """Return what was made for the weak form before, or make it."""
        kept = self._weak_form.derived
        if name not in kept:
            kept[name] = make()
        return kept[name]

    def _linearise(self, system: System) -> None:
        """Assemble the tangent at the solution, unless it is the last one that was assembled."""
        system.set_load(1.0)
        kept = self._weak_form.derived.get("tangent")
        if kept is None or not (kept[0]() is system and kept[1]() is self._solution and kept[2] == system.tangents):
            system.tangent()
            self._weak_form.derived["tangent"] = ref(system), ref(self._solution), system.tangents

    def _settled(self, equilibrium: Equilibrium) -> Any:
        """Return the tangent with the equations of interfaces, as the last time if that was at this solution."""
        kept = self._weak_form.derived.get("settled contacts")
        if kept is None or kept[0]() is not self._solution:
            if kept is not None:
                kept[1].destroy()
            kept = ref(self._solution), on_demand("settled contacts")(self._equations, self._solution, equilibrium)
            self._weak_form.derived["settled contacts"] = kept
        return kept[1]

    def _error(self, text: str) -> JobError:
        where = self._job.path or "job"
        return JobError(f"{where}: {self._caller}: {text}")

    def _fault_of(self, quantity: QuantityOfInterest) -> str:
        if reason := refusal_of(quantity):
            return reason
        is_layered = isinstance(self._equations.quadrature_degree, LayerDegree)
        is_simple = quantity.fields.issubset({"J"}) and quantity.at is None
        return "is of a field in the layers of a shell" if is_layered and quantity.fields and not is_simple else ""

    def _array(self, given: Any, shape: tuple[int, ...], what: str) -> Floats:
        try:
            array = np.asarray(given, dtype=np.float64)
        except (TypeError, ValueError):
            raise self._error(f"{what} is not an array of numbers") from None
        if array.shape != shape:
            raise self._error(f"{what} must have the shape {shape}, not {array.shape}")
        if not np.isfinite(array).all():
            raise self._error(f"{what} has values that are not finite")
        return array

    def _form_of(self, name: str) -> Variations:
        quantity, scales = self._quantities[name], self._equations.scales
        key = f"quantity {quantity.model_dump_json()} {scales}"
        form: QuantityForm = self._kept(key, lambda: QuantityForm(quantity, self._equations, self._weak_form))
        return form.linearised()

    def _slopes_of(self, name: str) -> PointSlopes:
        return point_slopes(self._quantities[name], self._equations, self._solution, self.maps)

    def _point_gradients(self, name: str) -> list[tuple[Floats, Floats]]:
        """Return derivatives by the displacement's nodes and by the mesh's nodes, of each component of a quantity."""
        count, found = len(self._unknowns.displacement_dofs_of_nodes), self._slopes_of(name)
        local = len(self._equations.body.source_geometry.x)
        gradients = []
        for by_u, by_position in zip(found.by_displacement, found.by_position, strict=True):
            if found.position is not None:
                at_mesh = found.position.at_nodes(by_position, local)
            else:
                at_mesh = np.zeros((local, 3))
                at_mesh[found.displacement.points] = by_position
            gradients.append((found.displacement.at_nodes(by_u, count), self.maps.summed(at_mesh)))
        return gradients

    @cached_property
    def _supports(self) -> SupportRates:
        return SupportRates(self._equations, self._solution)

    def _node_rates(self, parameter: Parameter) -> Floats:
        """Return rates (N, 3) of the nodes of the mesh by a number that moves them; collective."""
        rates = node_rates(self._job, self._equations.body, [parameter])[parameter.key]
        return self.maps.gathered(self.maps.source_positions(rates))

    def _field(self, key: str) -> FieldParameter:
        found = field_parameter(key, self._equations, self._weak_form, self.maps)
        if isinstance(found, str):
            raise self._error(found)
        return found

    def _field_of(self, parameter: Parameter) -> FieldParameter:
        return FieldParameter.of_number(parameter, self._equations, self._weak_form, self.maps)

    def _fault_of_nodes(self) -> str:
        if self._job.interfaces:
            return "derivatives by nodes are not supported with interfaces, whose surfaces they would move"
        if self._equations.supports.slides:
            return "derivatives by nodes are not supported with supports that slide: hold axes ('fix: [x]') instead"
        if any(family.rule is not None for family in self._job.fibres.values() if hasattr(family, "rule")):
            return "derivatives by nodes are not supported with fibres by a rule, which would turn with the nodes"
        return ""
