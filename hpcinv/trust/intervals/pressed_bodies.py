"""Solves of a given shape with given contact pressures, and what small changes of these do.

On the given shape the pressures p load both bodies through constant matrices. At a solution the displacement changes by
``K dw = F dp``, the gaps of the unloaded bodies by ``-B dw``, and each quantity by its slope along dw.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hpcinv.errors import SolveError
from hpcinv.job.job import Job
from hpcinv.job.sections import QuantityOfInterest
from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh.source import Floats
from hpcinv.model.contacts import ContactReport
from hpcinv.model.interfaces.pair import SurfacePair
from hpcinv.results.point_fields import PointFields
from hpcinv.results.quantities_of_interest import check_points, evaluate, fields_for, values_of
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.trust.intervals.admissible_pressures import AdmissiblePressures
from hpcinv.trust.intervals.position_slopes import is_of_positions, position_slopes
from hpcinv.trust.sensitivity.followed_numbers import FollowedNumbers
from hpcinv.trust.sensitivity.slopes import Change, slopes

_ACCURACY = 1e-10  # of solves with given pressures


@dataclass(frozen=True)
class Pressed:
    """A solve with given pressures.

    Attributes:
        values, slopes: of the quantities (SI), and their derivatives (n,) by the pressures (scaled).
        near: pressures that are admissible near these.
        shape: local geometry nodes (m) of the unloaded bodies.
    """

    values: Mapping[str, float]
    slopes: Mapping[str, Floats]
    near: AdmissiblePressures
    shape: Floats


class PressedBodies:
    """Solves of the given shape with given contact pressures. Methods are collective.

    Attributes:
        units: SI units by the names of the job's quantities, and of force and mean rest gap of each interface.
        start: pressures (scaled) of the solution.
    """

    def __init__(self, equations: Equations, solution: Solution) -> None:
        self._scales, self._body, self._solution = equations.scales, equations.body, solution
        wanted = [q for q in solution.job.quantities if not q.is_reaction]
        computed = evaluate(wanted, self._body, solution, equations)
        self._quantities = [q for q in wanted if isinstance(computed[q.name], float)]
        others = tuple(q for q in self._quantities if not is_of_positions(q))
        self._job = _with_given_pressures(solution.job).model_copy(update={"quantities": others})
        self._equations = Equations(self._job, equations.body, equations.timings, equations)
        self._fields = solution.fields
        self._point_fields: PointFields | None = None
        self._places = check_points(self._quantities, self._body)
        weak_form = equations.weak_form("inverse")
        equations.put(solution)
        self._pairs: list[SurfacePair] = [pair for pair in weak_form.contacts.pairs if pair.assumes_pressure]
        self.start: Floats = np.concatenate([pair.pressures[pair.pressing] for pair in self._pairs])
        self.units = {q.name: self._unit(q) for q in self._quantities}
        for pair in self._pairs:
            self.units |= {f"force on {pair.spec.between[0]}": "N", f"mean rest gap at {pair.spec.between[0]}": "m"}

    def _unit(self, quantity: QuantityOfInterest) -> str:
        """Return the SI unit of a quantity; an integral is over the cells of its region, if it has some."""
        region = self._body.regions.get(quantity.on or "")
        if quantity.reduce != "integral" or region is None:
            return quantity.unit
        return quantity.unit_of_integral(3 if region.cell_count else 2)

    def destroy(self) -> None:
        """Free PETSc objects."""
        self._equations.destroy()

    @cached_property
    def at_start(self) -> Pressed:
        """The solve with the pressures of the solution."""
        return self.solved(self.start)

    def solved(self, pressures: Floats) -> Pressed:
        """Solve with some pressures (scaled).

        Raises:
            SolveError: on all ranks, if that does not converge, or the tangent is singular.
        """
        equations = self._equations
        contacts = tuple(self._reports(pressures))
        equations.put(replace(self._solution, job=self._job, contacts=contacts))
        equations.put_fields(self._fields)
        equilibrium = equations.equilibrium(equations.weak_form("inverse"))
        solve = equilibrium.solve(1.0, _ACCURACY, begins_near=True)
        if not solve.outcome.accepted:
            equations.release(equilibrium)
            raise SolveError(
                f"with other contact pressures the solve ended: {solve.outcome.text}", solve.outcome.advice
            )
        state = equations.state()
        u = equations.unknowns.geometry_values(state.displacement)
        solution = replace(
            self._solution,
            job=self._job,
            displacement=state.displacement,
            pressure=state.pressure,
            u=u,
            contacts=contacts,
        )
        self._fields = solution.fields
        near, changes = self._linearised(equilibrium, solution, pressures)
        equations.release(equilibrium)
        if self._point_fields is None:
            self._point_fields = fields_for(self._quantities, self._body, equations.weak_form("inverse"), self._scales)
        equations.put(solution)
        values = values_of(self._quantities, self._body, solution, self._point_fields, self._places)
        own_values, own_slopes = self._of_interfaces(near)
        return Pressed(
            {q.name: float(values[q.name]) for q in self._quantities} | own_values,  # type: ignore[arg-type]
            self._slopes(solution, changes) | own_slopes,
            near,
            solution.other_nodes,
        )

    def _slopes(self, solution: Solution, changes: Sequence[tuple[Parameter, Change]]) -> dict[str, Floats]:
        """Return the slopes of the quantities by the pressures."""
        found, rates = dict[str, Floats](), [(change.displacement, change.u) for _, change in changes]
        for quantity in filter(is_of_positions, self._quantities):
            found[quantity.name] = position_slopes(quantity, self._body, solution, rates)
        if self._job.quantities:
            derivatives = slopes(self._equations, solution, changes, self._point_fields)
            for name, by_key in derivatives.items():
                found[name] = np.array([by_key[parameter.key] for parameter, _ in changes], dtype=np.float64)
        return found

    def _of_interfaces(self, near: AdmissiblePressures) -> tuple[dict[str, float], dict[str, Floats]]:
        """Return force (N) and mean rest gap (m) of each interface, and their slopes by the pressures."""
        values, by_pressure, first, first_gap = dict[str, float](), dict[str, Floats](), 0, 0
        force = self._scales.stress * self._scales.length**2
        for pair, count in zip(self._pairs, self._gap_counts, strict=True):
            name, areas = pair.spec.between[0], np.zeros(len(near.pressures))
            areas[first : first + len(pair.pressing)] = pair.areas[pair.pressing] * force
            values[f"force on {name}"], by_pressure[f"force on {name}"] = float(areas @ near.pressures), areas
            rows = slice(first_gap, first_gap + count)
            name, length = f"mean rest gap at {name}", self._scales.length
            values[name] = float(near.gaps[rows].mean()) * length
            by_pressure[name] = near.compliance[rows].mean(axis=0) * length
            first, first_gap = first + len(pair.pressing), first_gap + count
        return values, by_pressure

    def _reports(self, pressures: Floats) -> Iterator[ContactReport]:
        by_place = {pair.where: pair for pair in self._pairs}
        starts = dict(zip(by_place, np.cumsum([0, *(len(pair.pressing) for pair in self._pairs)]), strict=False))
        for report in self._solution.contacts:
            if report.where not in by_place:
                yield report
                continue
            pair = by_place[report.where]
            whole = np.zeros(len(pair.areas))
            start = starts[report.where]
            whole[pair.pressing] = pressures[start : start + len(pair.pressing)]
            yield pair.reports.with_pressures(report, whole, self._scales)

    def _linearised(
        self, equilibrium: Equilibrium, solution: Solution, pressures: Floats
    ) -> tuple[AdmissiblePressures, list[tuple[Parameter, Change]]]:
        equations, system = self._equations, equilibrium.system
        system.set_load(1.0)
        numbers = FollowedNumbers(equations, solution, equilibrium)
        position, b, x = system.position(), system.rhs.duplicate(), system.rhs.duplicate()
        pairs = [pair for pair in system.weak_form.contacts.pairs if pair.assumes_pressure]
        measured = [pair.node_gaps(loaded=False) for pair in pairs]
        unchanged = system.weak_form.parameters.direction({})
        columns, changes = list[Floats](), list[tuple[Parameter, Change]]()
        for pair, own in zip(pairs, self._pairs, strict=True):
            for number in own.pressing:
                b.array[:] = pair.unit_forces(int(number))
                equations.supports.free(b.array)
                found = numbers.solve(b, np.zeros(numbers.count), x)
                columns.append(-np.concatenate([gaps.rates(x) for gaps in measured]))
                system.set_state(x)
                u, p = equations.state().fields
                system.set_state(position)
                key = f"{pair.where} {number}"
                parameter = Parameter(key, pair.where, None, (), 0.0, None)
                changes.append((parameter, Change(unchanged, u, equations.unknowns.geometry_values(u), p, None, found)))
        numbers.destroy()
        for vector in (position, b, x):
            vector.destroy()
        found_gaps = [gaps.gaps for gaps in measured]
        for gaps in measured:
            gaps.destroy()
        self._gap_counts = [len(gaps) for gaps in found_gaps]
        return self._admissible(pressures, found_gaps, np.array(columns).T), changes

    def _admissible(self, pressures: Floats, gaps: Sequence[Floats], compliance: Floats) -> AdmissiblePressures:
        scales, numbers = self._scales, [len(pair.pressing) for pair in self._pairs]
        unit, ends = scales.stress * scales.length**2, np.cumsum(numbers)
        greatest, widest, forces = list[Floats](), list[Floats](), list[tuple[Floats, float, float]]()
        for pair, own, end in zip(self._pairs, gaps, ends, strict=True):
            known, count = pair.spec.known, len(pair.pressing)
            pressure, gap = known.greatest_pressure, known.greatest_rest_gap
            greatest.append(np.full(count, np.inf if pressure is None else pressure / scales.stress))
            widest.append(np.full(len(own), np.inf if gap is None else gap / scales.length))
            if known.force is not None:
                areas = np.zeros(len(pressures))
                areas[end - count : end] = pair.areas[pair.pressing]
                forces.append((areas, known.force[0] / unit, known.force[1] / unit))
        bounds = np.concatenate(greatest), np.concatenate(widest)
        return AdmissiblePressures(pressures, np.concatenate(gaps), compliance, *bounds, forces)


def _with_given_pressures(job: Job) -> Job:
    given = {"closure": "given", "rest_gap": None}
    interfaces = tuple(i.model_copy(update=given) if i.kind == "contact" else i for i in job.interfaces)
    effects = tuple(effect.model_copy(update=given) if effect.is_paired else effect for effect in job.effects)
    return job.model_copy(update={"interfaces": interfaces, "effects": effects})
