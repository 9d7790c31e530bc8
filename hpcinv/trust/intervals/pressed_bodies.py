"""Solves of a given shape with given contact tractions, and what small changes of these do.

On the given shape the tractions z load both bodies through constant matrices. At a solution the displacement changes by
``K dw = F dz``, the gaps of the unloaded bodies by ``-B dw``, and each quantity by its slope along dw. Parts that
contact alone holds have springs along their free motions; z also has the places ``c₀`` of these springs along which
such a part can be lifted off. Admissible tractions leave no force in the springs (`hpcinv.model.interfaces.pins`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from dolfinx import fem
from scipy.sparse import csr_array, vstack

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import SolveError
from hpcinv.job.job import Job
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh import Body
from hpcinv.mesh.source import Floats
from hpcinv.model.contact_reports import ContactReport
from hpcinv.model.interfaces.pair import SurfacePair
from hpcinv.model.interfaces.pins import Pins
from hpcinv.results.point_fields import PointFields
from hpcinv.results.quantities_of_interest import check_points, evaluate, fields_for, values_of
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.free_parts import pins_of_loose_parts
from hpcinv.trust.intervals.admissible_tractions import AdmissibleTractions
from hpcinv.trust.intervals.lifts import Lifts
from hpcinv.trust.intervals.position_slopes import is_of_positions, position_slopes
from hpcinv.trust.intervals.rest_surfaces import known_rest_surfaces
from hpcinv.trust.intervals.stored_energy import StoredEnergy, stored_energy
from hpcinv.trust.intervals.varied_tractions import VariedTractions
from hpcinv.trust.sensitivity.followed_numbers import FollowedNumbers
from hpcinv.trust.sensitivity.slopes import Change, slopes

_ACCURACY = 1e-10  # of solves with given pressures


@dataclass(frozen=True)
class Pressed:
    """A solve with given tractions.

    Attributes:
        values, slopes: of the quantities (SI), and their derivatives (n,) by the numbers (scaled).
        near: numbers that are admissible near these.
        solution: with these tractions.
        energy: of the bodies, where it is asked for.
    """

    values: Mapping[str, float]
    slopes: Mapping[str, Floats]
    near: AdmissibleTractions
    solution: Solution
    energy: StoredEnergy | None = None

    @property
    def shape(self) -> Floats:
        """Local geometry nodes (m) of the unloaded bodies."""
        return self.solution.other_nodes


class PressedBodies:
    """Solves of the given shape with given contact tractions. Methods are collective.

    Args:
        with_energy: whether solves have the stored energy.
        announce: called with what a solve takes, when the first substitution has been measured.

    Attributes:
        units: SI units by the names of the job's quantities, and of force and mean rest gap of each interface.
        comm: of the body.
        computed: values of the quantities at the solution.
        fine: number of functions that may press, where the pressures among the numbers are a coarse field; else 0.
        count: number of pressures and tangential tractions.
        moves: derivatives (m) of the displacement by each number, at the first solve.
        start: numbers (scaled) of the solution: tractions of each interface, and places of free parts.
    """

    def __init__(
        self,
        equations: Equations,
        solution: Solution,
        *,
        with_energy: bool = False,
        announce: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._announce: Callable[[str], None] | None = announce
        self._scales, self._body, self._solution = equations.scales, equations.body, solution
        self._with_energy, self.comm = with_energy, equations.body.mesh.comm
        self.moves = list[fem.Function]()
        wanted = [q for q in solution.job.quantities if not q.is_reaction]
        computed = evaluate(wanted, self._body, solution, equations)
        self._quantities = [q for q in wanted if isinstance(computed[q.name], float)]
        self.computed = {q.name: float(computed[q.name]) for q in self._quantities}  # type: ignore[arg-type]
        others = tuple(q for q in self._quantities if not is_of_positions(q))
        self._job = _with_given_pressures(solution.job).model_copy(update={"quantities": others})
        self._equations = Equations(self._job, equations.body, equations.timings, equations)
        self._fields = solution.fields
        self._point_fields: PointFields | None = None
        self._places = check_points(self._quantities, self._body)
        weak_form = equations.weak_form("inverse")
        equations.put(solution)
        self._varied = _varied([pair for pair in weak_form.contacts.pairs if pair.assumes_pressure])
        starts = [own.present() for own in self._varied]
        self.count = sum(own.count for own in self._varied)
        is_coarse = any(own.fine > own.pressures for own in self._varied)
        self.fine = sum(own.fine for own in self._varied) if is_coarse else 0
        own_form = self._equations.weak_form("inverse")
        pins = pins_of_loose_parts(self._job, self._body, equations.supports, own_form)
        own_form.contacts.pins = tuple(pins)
        surfaces = [own.pair for own in self._varied]
        named = [(pair.where, pair.spec) for pair in surfaces]
        self._rest_surfaces = known_rest_surfaces(named, solution.job, self._body)
        self._lifts = Lifts(pins, surfaces)
        equations.put(solution)
        self.start: Floats = np.concatenate([*starts, self._lifts.begin(pins, equations.unknowns)])
        self.units = {q.name: unit_of(q, self._body) for q in self._quantities}
        for own in self._varied:
            name = own.pair.spec.between[0]
            self.units[f"force on {name}"] = "N"
            if not self._lifts.count:  # free parts can be lifted off
                self.units[f"mean rest gap at {name}"] = "m"

    def destroy(self) -> None:
        """Free PETSc objects."""
        self._equations.destroy()

    @cached_property
    def at_start(self) -> Pressed:
        """The solve with the numbers of the solution."""
        return self.solved(self.start)

    def solved(self, values: Floats) -> Pressed:
        """Solve with some numbers (scaled).

        Raises:
            SolveError: on all ranks, if that does not converge, or the tangent is singular.
        """
        equations = self._equations
        contacts = tuple(self._reports(values))
        equations.put(replace(self._solution, job=self._job, contacts=contacts))
        equations.put_fields(self._fields)
        self._lifts.put(values, equations.weak_form("inverse").contacts.pins)
        equilibrium = equations.equilibrium(equations.weak_form("inverse"))
        solve = equilibrium.solve(1.0, _ACCURACY, begins_near=True)
        if not solve.outcome.accepted:
            equations.release(equilibrium)
            raise SolveError(
                f"with other contact tractions the solve ended: {solve.outcome.text}", solve.outcome.advice
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
        near, changes, stiffness = self._linearised(equilibrium, solution, values)
        self.moves = self.moves or [change.displacement for _, change in changes]
        equations.release(equilibrium)
        if self._point_fields is None:
            self._point_fields = fields_for(self._quantities, self._body, equations.weak_form("inverse"), self._scales)
        energy = stored_energy(equations, solution, [c for _, c in changes], stiffness) if self._with_energy else None
        equations.put(solution)
        found = values_of(self._quantities, self._body, solution, self._point_fields, self._places)
        own_values, own_slopes = self._of_interfaces(near)
        return Pressed(
            {q.name: float(found[q.name]) for q in self._quantities} | own_values,  # type: ignore[arg-type]
            self._slopes(solution, changes) | own_slopes,
            near,
            solution,
            energy,
        )

    def _slopes(self, solution: Solution, changes: Sequence[tuple[Parameter, Change]]) -> dict[str, Floats]:
        """Return the slopes of the quantities by the numbers."""
        found, rates = dict[str, Floats](), [(change.displacement, change.u) for _, change in changes]
        for quantity in filter(is_of_positions, self._quantities):
            found[quantity.name] = position_slopes(quantity, self._body, solution, rates)
        if self._job.quantities:
            derivatives = slopes(self._equations, solution, changes, self._point_fields)
            for name, by_key in derivatives.items():
                found[name] = np.array([by_key[parameter.key] for parameter, _ in changes], dtype=np.float64)
        return found

    def _of_interfaces(self, near: AdmissibleTractions) -> tuple[dict[str, float], dict[str, Floats]]:
        """Return force (N) and mean rest gap (m) of each interface, and their slopes by the numbers."""
        values, by_number, first_gap = dict[str, float](), dict[str, Floats](), 0
        force = self._scales.stress * self._scales.length**2
        for own, count in zip(self._varied, self._gap_counts, strict=True):
            name, areas = own.pair.spec.between[0], np.zeros(len(near.values))
            areas[own.numbers] = own.areas * force
            values[f"force on {name}"], by_number[f"force on {name}"] = float(areas @ near.values), areas
            rows = slice(first_gap, first_gap + count)
            name, length = f"mean rest gap at {name}", self._scales.length
            values[name] = float(near.gaps[rows].mean()) * length
            by_number[name] = near.compliance[rows].mean(axis=0) * length
            first_gap += count
        return values, by_number

    def _reports(self, values: Floats) -> Iterator[ContactReport]:
        varied = {own.pair.where: own for own in self._varied}
        for report in self._solution.contacts:
            if (own := varied.get(report.where)) is None:
                yield report
                continue
            yield own.pair.reports.with_tractions(report, *own.whole(values[own.numbers]), self._scales)

    def _linearised(
        self, equilibrium: Equilibrium, solution: Solution, values: Floats
    ) -> tuple[AdmissibleTractions, list[tuple[Parameter, Change]], Floats]:
        """Return what is admissible near the values, changes by each of them, and ``Fᵀ K⁻¹ F`` of their forces."""
        equations, system = self._equations, equilibrium.system
        system.set_load(1.0)
        numbers = FollowedNumbers(equations, solution, equilibrium)
        position, b, x = system.position(), system.rhs.duplicate(), system.rhs.duplicate()
        contacts = system.weak_form.contacts
        measured = [pair.node_gaps(loaded=False) for pair in contacts.pairs if pair.assumes_pressure]
        unchanged = system.weak_form.parameters.direction({})
        columns, motions, changes = list[Floats](), list[Floats](), list[tuple[Parameter, Change]]()
        all_forces = csr_array(vstack([csr_array(f[None, :]) for f in self._unit_forces(contacts.pins)]))
        products = list[Floats]()
        for number in range(all_forces.shape[0]):
            started = time.perf_counter()
            b.array[:] = all_forces[[number]].toarray()[0]
            equations.supports.free(b.array)
            found = numbers.solve(b, np.zeros(numbers.count), x)
            if number == 1 and self._announce is not None:  # the first one may factorize
                self._announce(self._price(time.perf_counter() - started))
                self._announce = None
            products.append(all_forces @ x.array)
            columns.append(-np.concatenate([gaps.rates(x) for gaps in measured]))
            motions.append(np.concatenate([np.zeros(0), *(pin.motion(x) for pin in contacts.pins)]))
            system.set_state(x)
            u, p = equations.state().fields
            system.set_state(position)
            parameter = Parameter(str(number), "interfaces", None, (), 0.0, None)
            changes.append((parameter, Change(unchanged, u, equations.unknowns.geometry_values(u), p, None, found)))
        left = [pin.motion(position) - pin.places for pin in contacts.pins]
        numbers.destroy()
        for vector in (position, b, x):
            vector.destroy()
        found_gaps = [gaps.gaps for gaps in measured]
        for gaps in measured:
            gaps.destroy()
        self._gap_counts = [len(gaps) for gaps in found_gaps]
        compliance, unbalanced = np.array(columns).T, None
        if left:
            unbalanced = np.concatenate(left), np.array(motions).T - self._lifts.place_rates(len(values))
        stiffness = self._body.mesh.comm.allreduce(np.array(products))
        near = self._admissible(values, found_gaps, compliance, unbalanced)
        return replace(near, bands=self._bands(solution, [c.u for _, c in changes])), changes, stiffness

    def _bands(self, solution: Solution, rates: Sequence[Floats]) -> list[tuple[Floats, Floats, float]]:
        """Return distances from known rest surfaces, their rates by the numbers, and the largest ones, all scaled."""
        length, bands = self._scales.length, list[tuple[Floats, Floats, float]]()
        for surface in self._rest_surfaces:
            distances, by_number = surface.distances(solution, rates)
            bands.append((distances / length, by_number / length, surface.within / length))
        return bands

    def _price(self, seconds: float) -> str:
        """Return what a solve takes, for the seconds of one substitution; collective."""
        seconds = self.comm.allreduce(seconds, op=MPI.MAX) * self.count
        coarse = f" of a coarse field of {self.fine:,} pressures" if self.fine else ""
        each = f"a factorization, and as many substitutions in {seconds:.2g} s"
        return f"{self.count:,} tractions{coarse}: each solve takes {each}"

    def _unit_forces(self, pins: Sequence[Pins]) -> Iterator[Floats]:
        """Yield the nodal forces (owned unknowns, scaled) of a unit of each number."""
        for own in self._varied:
            yield from (own.unit_forces(number) for number in range(own.count))
        yield from self._lifts.unit_forces(pins)

    def _admissible(
        self,
        values: Floats,
        gaps: Sequence[Floats],
        compliance: Floats,
        unbalanced: tuple[Floats, Floats] | None,
    ) -> AdmissibleTractions:
        scales, no_bounds = self._scales, np.full(self._lifts.count, np.inf)
        unit = scales.stress * scales.length**2
        greatest, widest, forces = list[Floats](), list[Floats](), list[tuple[Floats, float, float]]()
        for varied, own in zip(self._varied, gaps, strict=True):
            known = varied.pair.spec.known
            pressure, gap = known.greatest_pressure, known.greatest_rest_gap
            greatest.append(varied.greatest(None if pressure is None else pressure / scales.stress))
            widest.append(np.full(len(own), np.inf if gap is None else gap / scales.length))
            if known.force is not None:
                areas = np.zeros(len(values))
                areas[varied.numbers] = varied.areas
                forces.append((areas, known.force[0] / unit, known.force[1] / unit))
        return AdmissibleTractions(
            values,
            np.concatenate(gaps),
            compliance,
            np.concatenate([*greatest, no_bounds]),
            np.concatenate(widest),
            forces,
            np.concatenate([*(own.lowest for own in self._varied), -no_bounds]),
            [cone for own in self._varied for cone in own.cones()],
            unbalanced,
        )


def unit_of(quantity: QuantityOfInterest, body: Body) -> str:
    """Return the SI unit of a quantity; an integral is over the cells of its region, if it has some."""
    region = body.regions.get(quantity.on or "")
    if quantity.reduce != "integral" or region is None:
        return quantity.unit
    return quantity.unit_of_integral(3 if region.cell_count else 2)


def _varied(pairs: Sequence[SurfacePair]) -> list[VariedTractions]:
    found = list[VariedTractions]()
    for pair in pairs:
        found.append(VariedTractions(pair, sum(own.count for own in found)))
    return found


def _with_given_pressures(job: Job) -> Job:
    given = {"closure": "given", "rest_gap": None}
    interfaces = tuple(i.model_copy(update=given) if i.kind == "contact" else i for i in job.interfaces)
    effects = tuple(effect.model_copy(update=given) if effect.is_paired else effect for effect in job.effects)
    return job.model_copy(update={"interfaces": interfaces, "effects": effects})
