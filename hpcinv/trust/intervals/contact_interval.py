"""Quantities of interest between all contact pressures that a given shape admits.

On the given shape the pressures p load both bodies through constant matrices. At a solution the displacement changes by
``K dw = F dp``, the gaps of the unloaded bodies by ``-B dw``, and each quantity by its slope along dw. A linear program
gives the pressures at an end; a solve with these shows the quantity there, and the next program begins there, until it
has settled.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import SolveError
from hpcinv.job.job import Job
from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh.source import Floats
from hpcinv.model.contacts import ContactReport
from hpcinv.model.interfaces.pair import SurfacePair
from hpcinv.results.quantities_of_interest import evaluate
from hpcinv.results.solution import Solution, solution_of
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.trust.intervals.admissible_pressures import (
    AdmissiblePressures,
    NoPressure,
    UnboundedEnd,
    settled_end,
)
from hpcinv.trust.sensitivity.followed_numbers import FollowedNumbers
from hpcinv.trust.sensitivity.slopes import Change, slopes

_SETTLED = 1e-6
"""Change of a quantity by one more program at which its end has settled, relative to its value or distance."""
_ACCURACY = 1e-10  # of solves with given pressures


@dataclass(frozen=True)
class Interval:
    """Ends of one quantity, in SI; ``None`` for an end that does not exist.

    Attributes:
        has_settled: whether one more linear program would not move either end.
    """

    name: str
    low: float | None
    high: float | None
    has_settled: bool


@dataclass(frozen=True)
class ContactIntervals:
    """Intervals of a job's quantities.

    Attributes:
        distance: largest distance (m) between two unloaded shapes at ends, a lower bound of what is undetermined.
        overlap: depth (m) to which the unloaded bodies overlap for every pressure, 0 if what is known excludes all;
            ``None`` where some are admissible.
        count: number of pressures.
    """

    intervals: tuple[Interval, ...]
    distance: float
    overlap: float | None
    count: int


def contact_intervals(equations: Equations, solution: Solution) -> ContactIntervals:
    """Return the intervals of the scalar quantities of an inverse solution with contact; collective.

    It takes, for each end, some factorizations, each with a substitution for each pressure.
    """
    problem, overlap = _Pressed(equations, solution), None
    found = list[Interval]()
    try:
        for name in problem.names:
            found.append(problem.interval(name))
    except NoPressure as reason:
        overlap = -reason.gap * equations.scales.length
    finally:
        problem.destroy()
        equations.put(solution)
    return ContactIntervals(tuple(found), problem.distance, overlap, problem.count)


@dataclass(frozen=True)
class _Solved:
    """A solve with given pressures.

    Attributes:
        values, slopes: of the quantities, and their derivatives (n,) by the pressures.
        near: pressures that are admissible near these.
    """

    values: dict[str, float]
    near: AdmissiblePressures
    slopes: dict[str, Floats]


class _Pressed:
    """Solves of the given shape with given contact pressures. Methods are collective."""

    def __init__(self, equations: Equations, solution: Solution) -> None:
        self._scales, self._body, self._solution = equations.scales, equations.body, solution
        self._job = _with_given_pressures(solution.job)
        self._equations = Equations(self._job, equations.body, equations.timings, equations)
        self._fields, self._shapes = solution.fields, list[Floats]()
        weak_form = equations.weak_form("inverse")
        equations.put(solution)
        self._pairs: list[SurfacePair] = [pair for pair in weak_form.contacts.pairs if pair.assumes_pressure]
        self._start = np.concatenate([pair.pressures[pair.pressing] for pair in self._pairs])
        self.count = len(self._start)
        quantities = [q for q in solution.job.quantities if not q.is_reaction]
        computed = evaluate(quantities, self._body, solution, equations)
        self.names = [name for name, value in computed.items() if isinstance(value, float)]
        self._first = self._solved(self._start) if self.names else None

    @property
    def distance(self) -> float:
        """Largest distance (m) of a node in two of the shapes that were found."""
        largest = max(
            (float(np.linalg.norm(a - b, axis=1).max(initial=0.0)) for a, b in combinations(self._shapes, 2)),
            default=0.0,
        )
        return float(self._body.mesh.comm.allreduce(largest, op=MPI.MAX))

    def destroy(self) -> None:
        """Free PETSc objects."""
        self._equations.destroy()

    def interval(self, name: str) -> Interval:
        """Return the interval of a quantity; raise `NoPressure` if no pressures are admissible."""

        def solve(pressures: Floats) -> tuple[float, AdmissiblePressures, Floats]:
            solved = self._first if pressures is self._start and self._first else self._solved(pressures)
            return solved.values[name], solved.near, solved.slopes[name]

        ends, settled = list[float | None](), True
        first = solve(self._start)[0]
        for sign in (-1.0, 1.0):
            tolerance = _SETTLED * max(abs(first), *(abs(end - first) for end in ends if end is not None), 1e-300)
            try:
                value, _, has_settled = settled_end(solve, partial(self._chosen, sign), self._start, tolerance)
            except UnboundedEnd:
                ends.append(None)
                continue
            ends.append(value)
            settled &= has_settled
            self._shapes.append(self._last_shape)
        return Interval(name, ends[0], ends[1], settled)

    def _chosen(self, sign: float, near: AdmissiblePressures, slopes_of_pressures: Floats) -> Floats:
        """Return the pressures at an end, found on one rank: others might choose other pressures for the same end."""
        comm = self._body.mesh.comm
        found: Any = None
        if comm.rank == 0:
            try:
                found = near.end(slopes_of_pressures, sign)
            except (UnboundedEnd, NoPressure) as reason:
                found = reason
        found = comm.bcast(found)
        if isinstance(found, Exception):
            raise found
        pressures: Floats = found
        return pressures

    def _solved(self, pressures: Floats) -> _Solved:
        """Solve with some pressures.

        Raises:
            SolveError: on all ranks, if that does not converge, or the tangent is singular.
        """
        equations = self._equations
        equations.put(replace(self._solution, job=self._job, contacts=tuple(self._reports(pressures))))
        equations.put_fields(self._fields)
        equilibrium = equations.equilibrium(equations.weak_form("inverse"))
        solve = equilibrium.solve(1.0, _ACCURACY, begins_near=True)
        if not solve.outcome.accepted:
            equations.release(equilibrium)
            raise SolveError(
                f"with other contact pressures the solve ended: {solve.outcome.text}", solve.outcome.advice
            )
        solution = solution_of(equations, "inverse", equilibrium.system.weak_form, (solve,))
        self._fields, self._last_shape = solution.fields, solution.other_nodes
        near, changes = self._linearised(equilibrium, solution, pressures)
        equations.release(equilibrium)
        wanted = [q for q in self._job.quantities if q.name in self.names]
        values = evaluate(wanted, self._body, solution, equations)
        derivatives = slopes(equations, solution, changes)
        return _Solved(
            {name: float(values[name]) for name in self.names},  # type: ignore[arg-type]  # these are numbers
            near,
            {name: np.array([derivatives[name][p.key] for p, _ in changes], dtype=np.float64) for name in self.names},
        )

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
            yield pair.with_pressures(report, whole, self._scales)

    def _linearised(
        self, equilibrium: Equilibrium, solution: Solution, pressures: Floats
    ) -> tuple[AdmissiblePressures, list[tuple[Parameter, Change]]]:
        equations, system = self._equations, equilibrium.system
        system.set_load(1.0)
        numbers = FollowedNumbers(equations, solution, equilibrium)
        position, b, x = system.position(), system.rhs.duplicate(), system.rhs.duplicate()
        pairs = [pair for pair in system.weak_form.contacts.pairs if pair.assumes_pressure]
        measured = [pair.unloaded_gaps() for pair in pairs]
        unchanged = system.weak_form.parameters.direction({})
        columns, changes = list[Floats](), list[tuple[Parameter, Change]]()
        for pair, own in zip(pairs, self._pairs, strict=True):
            for number in own.pressing:
                b.array[:] = pair.unit_forces(int(number))
                equations.supports.free(b.array)
                found = numbers.solve(b, np.zeros(numbers.count), x)
                columns.append(np.concatenate([rates(x) for _, rates in measured]))
                system.set_state(x)
                u, p = equations.state().fields
                system.set_state(position)
                key = f"{pair.where} {number}"
                parameter = Parameter(key, pair.where, None, (), 0.0, None)
                changes.append((parameter, Change(unchanged, u, equations.unknowns.geometry_values(u), p, None, found)))
        numbers.destroy()
        for vector in (position, b, x):
            vector.destroy()
        return self._admissible(pressures, [gaps for gaps, _ in measured], np.array(columns).T), changes

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
    return job.model_copy(update={"interfaces": interfaces})
