"""Slopes of quantities of interest along a known change of solution and parameters.

A quantity is an explicit function ``Q(u, p, θ)``: its derivative along ``(du, dp, dθ)`` needs no solve. By central
differences of fourth order with a step of 2⁻¹⁰ of the smallest of displacement, pressure and parameter, their error is
about 1e-12 of the slope, and 1e-13 of the quantity over what it changes by as the parameter doubles.

Laws such as Holzapfel, Gasser & Ogden's have a kink where fibres begin to carry tension: a difference over it is the
slope of neither side. So has a ``max`` or ``min`` where another point takes over. There the differences are also taken
with a step of 2⁻²². Where these two disagree, the second counts: it has an error of about 1e-8, and passes no kink that
is farther than twice its step.

In a further state of a body, the reference shape X on which it is solved, and the displacement of the given state, to
which fibres and fields are attached, change too: ``Q(u, p, θ, X, u₀)``.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.parameter_paths import POINTS, central_difference
from hpcinv.job.job import Job
from hpcinv.job.quantity_of_interest import QuantityOfInterest, QuantityValue
from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh import Body
from hpcinv.mesh.location import Point, PointLocation
from hpcinv.mesh.source import Floats
from hpcinv.model.constraint_report import ConstraintReport
from hpcinv.model.parameters import ParameterDirection
from hpcinv.model.state import State
from hpcinv.results.point_fields import PointFields
from hpcinv.results.quantities_of_interest import carried, check_points, fields_for, values_of
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations

STEP = 2.0**-10
"""Length of differences, as part of what would change a solution by its own size."""
SHORT = 2.0**-12
"""Shorter step over `STEP` where there may be kinks; the error by rounding is inversely proportional to it."""
_AGREEING = 1e-7  # relative difference of slopes up to which the longer step, with its smaller error, counts
_ROUNDING = 16 * np.finfo(float).eps  # error of a quantity by rounding, relative to its value
_KINKS = re.compile(r"\b(max|min|abs)\(")
_EXTREMES = ("max", "min", "max_abs")
_SMALL = 1e-3  # displacement of an unloaded body that counts as much, relative to the body


@dataclass(frozen=True)
class ReferenceChange:
    """Derivatives by one parameter of the mesh on which a state is solved, and of what it takes from the given one.

    Attributes:
        nodes: of the mesh's local geometry nodes, (n, 3): for a further state the reference shape's.
        given_displacement: of the displacement of the given state, in m; ``None`` in that state itself.
        limit: parameter's change by which the given state's displacement would double, or cells change their shape.
    """

    nodes: Floats
    given_displacement: fem.Function | None
    limit: float

    def moved[S: State](self, state: S, step: float) -> S:
        """Return a state with the reference shape a step further, and the given state likewise."""
        return replace(
            state,
            mesh_nodes=state.mesh_nodes + step * self.nodes,
            given_displacement=shifted(state.given_displacement, self.given_displacement, step),
        )


@dataclass(frozen=True)
class Change:
    """Derivatives by one parameter (SI): of the weak form's parameters (scaled), displacement (m) and pressure (Pa).

    ``u`` is the displacement's at the local geometry nodes, (n, 3); ``reference`` is for further states; ``numbers``
    are the derivatives (SI) of numbers that the solve found, in the order of the solution's reports.
    """

    direction: ParameterDirection
    displacement: fem.Function
    u: Floats
    pressure: fem.Function | None
    reference: ReferenceChange | None = None
    numbers: Floats = field(default_factory=lambda: np.zeros(0))


def slopes(
    equations: Equations,
    solution: Solution,
    changes: Sequence[tuple[Parameter, Change]],
    fields: PointFields | None = None,
) -> dict[str, dict[str, QuantityValue]]:
    """Return derivatives (SI) of each quantity of interest, without reactions, by the parameters' keys.

    Collective.

    Args:
        fields: that the quantities need; made if they are not given, which takes longer than a value.
    """
    equations.put(solution)
    weak_form, body = equations.weak_form(solution.direction), equations.body
    quantities = [quantity for quantity in solution.job.quantities if not quantity.is_reaction]
    fields = fields or fields_for(quantities, body, weak_form, equations.scales)
    moved = _ShiftedValues(equations, solution, quantities, fields, _located(quantities, body, changes))
    kinked = _kinked(quantities, has_kinks(solution.job))
    derivatives: dict[str, dict[str, QuantityValue]] = {quantity.name: {} for quantity in quantities}
    for parameter, change in changes if derivatives else ():
        step = _step(equations, solution, parameter, change)
        values = [moved.at(change, k * step) for k in POINTS]
        found = {name: central_difference([v[name] for v in values], step) for name in derivatives}
        if kinked:
            short_values = [moved.at(change, k * SHORT * step) for k in POINTS]
            found |= {n: _checked(found[n], [v[n] for v in short_values], SHORT * step) for n in kinked}
        for name, slope in found.items():
            derivatives[name][parameter.key] = slope.tolist()
    return derivatives


@dataclass(frozen=True)
class _ShiftedValues:
    """Values of quantities at shifted solutions; points of quantities are ``located`` if the mesh stays."""

    equations: Equations
    solution: Solution
    quantities: Sequence[QuantityOfInterest]
    fields: PointFields | None
    located: Mapping[Point, PointLocation | None] | None

    def at(self, change: Change, shift: float) -> dict[str, Floats]:
        """Return the values; they are arrays. Collective."""
        equations, solution, body = self.equations, self.solution, self.equations.body
        moved, wanted, places = _shifted_solution(solution, change, shift), self.quantities, self.located
        if change.reference is not None:
            wanted, places = list(carried(wanted, body, moved.mesh_nodes)), None
        if change.reference is not None or solution.constraints or not solution.contacts:
            equations.put(moved)
        elif self.fields is not None:  # contacts stay: a search of surfaces takes longer than all else
            equations.put_fields(moved.fields, locates=False)
        with equations.weak_form(solution.direction).parameters.moved(change.direction, shift):
            return {name: np.array(v) for name, v in values_of(wanted, body, moved, self.fields, places).items()}


def _shifted_solution(solution: Solution, change: Change, shift: float) -> Solution:
    moved = solution if change.reference is None else change.reference.moved(solution, shift)
    return replace(
        moved,
        u=solution.u + shift * change.u,
        displacement=shifted(solution.displacement, change.displacement, shift),
        pressure=shifted(solution.pressure, change.pressure, shift),
        constraints=tuple(_reports(solution, shift * change.numbers)),
    )


def _located(
    quantities: Sequence[QuantityOfInterest], body: Body, changes: Sequence[tuple[Parameter, Change]]
) -> Mapping[Point, PointLocation | None] | None:
    """Return where points of quantities are; ``None`` if all changes move the mesh, and points with it. Collective."""
    is_there = any(change.reference is None for _, change in changes)
    return check_points(quantities, body) if is_there else None


def _kinked(quantities: Iterable[QuantityOfInterest], is_job_kinked: bool) -> set[str]:
    """Return the names of the quantities that may have kinks."""
    return {
        quantity.name
        for quantity in quantities
        if (is_job_kinked and quantity.fields) or quantity.reduce in _EXTREMES or _KINKS.search(quantity.of.source)
    }


def _checked(slope: Floats, short_values: Sequence[Floats], step: float) -> Floats:
    """Return a slope where a shorter step gives the same, else the slope of the shorter step."""
    short = central_difference(short_values, step)
    rounding = _ROUNDING * np.abs(short_values[0]) / step
    agree = np.abs(slope - short) <= np.maximum(_AGREEING * np.abs(short), rounding)
    return np.where(agree, slope, short)


def _reports(solution: Solution, step: Floats) -> Iterator[ConstraintReport]:
    """Yield the reports of unknown numbers of a solution, which are a step further."""
    first = 0
    for report in solution.constraints:
        yield report.shifted(step[first : first + report.count].tolist())
        first += report.count


def shifted(function: fem.Function | None, rate: fem.Function | None, step: float) -> Any:
    """Return a function a step along its rate; the function itself where there is no rate."""
    if function is None or rate is None:
        return function
    moved = function.copy()
    moved.x.array[:] += step * rate.x.array
    return moved


def has_kinks(job: Job) -> bool:
    """Return whether the energy of a law of the job has a discontinuous second derivative by its formula."""
    return any(_KINKS.search(getattr(law, "formula", "")) for law in job.laws.values())


def _step(equations: Equations, solution: Solution, parameter: Parameter, change: Change) -> float:
    """Length of the differences by the parameter (SI)."""
    comm = equations.body.mesh.comm
    limits = [abs(parameter.value)] if parameter.value else []
    limits.append(change_limit(equations, solution, change.displacement))
    if solution.pressure is not None and change.pressure is not None:
        p, dp = _largest(comm, solution.pressure), _largest(comm, change.pressure)
        limits += [p / dp] if p and dp else []
    if change.reference is not None:
        limits.append(change.reference.limit)
    least = min(limits)
    return STEP * (least if math.isfinite(least) else 1.0)


def change_limit(equations: Equations, solution: Solution, rate: fem.Function) -> float:
    """Return the change (SI) of a parameter by which the displacement (m), with that rate, would double; collective."""
    comm = equations.body.mesh.comm
    u, du = _largest(comm, solution.displacement), _largest(comm, rate)
    return (u or _SMALL * equations.body.length_scale) / du if du else math.inf


def _largest(comm: MPI.Intracomm, function: fem.Function) -> float:
    return float(comm.allreduce(float(np.abs(function.x.array).max(initial=0.0)), op=MPI.MAX))
