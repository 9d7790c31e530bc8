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
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem

from hpcinv.job.job import Job
from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh.moved import placed
from hpcinv.mesh.source import Floats
from hpcinv.model.parameters import Direction
from hpcinv.parallel.runtime import MPI
from hpcinv.quantity.parameter_paths import POINTS, central_difference
from hpcinv.results.quantities_of_interest import Value, carried, fields_for, values_of
from hpcinv.results.solution import Solution
from hpcinv.solver.problem import Model

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
        nodes: of the mesh's local geometry nodes, (n, 3): for a further state those of the reference shape.
        given: of the given state's displacement, in m; ``None`` in that state itself.
        limit: parameter's change by which the given state's displacement would double, or cells change their shape.
    """

    nodes: Floats
    given: fem.Function | None
    limit: float

    @contextmanager
    def at(self, model: Model, nodes: Floats, step: float) -> Iterator[None]:
        """Context with the reference shape a step away from ``nodes`` (m), and the given state likewise."""
        moved = (nodes + step * self.nodes) / model.body.length_scale
        with placed(model.body.mesh, moved), model.given_moved(self.given, step):
            yield


@dataclass(frozen=True)
class Change:
    """Derivatives by one parameter (SI): of the scene's parameters (scaled), displacement (m) and pressure (Pa).

    ``u`` is that of the displacement at the local geometry nodes, (n, 3); ``reference`` is for further states.
    """

    along: Direction
    displacement: fem.Function
    u: Floats
    pressure: fem.Function | None
    reference: ReferenceChange | None = None


def slopes(
    model: Model, solution: Solution, changes: Sequence[tuple[Parameter, Change]]
) -> dict[str, dict[str, Value]]:
    """Return derivatives (SI) of each quantity of interest, without reactions, by the parameters' keys.

    Collective; the mesh must lie as the job gives it.
    """
    scene, body = model.scene(solution.direction), model.body
    quantities = [quantity for quantity in model.job.quantities if not quantity.is_reaction]
    scene.parameters.set_load(1.0)
    with model.at(solution.mesh_nodes, *solution.fields):
        fields = fields_for(quantities, body, scene, model.scales)

    def at(change: Change, shift: float) -> dict[str, Floats]:
        u, p = solution.displacement.copy(), solution.pressure and solution.pressure.copy()
        u.x.array[:] += shift * change.displacement.x.array
        if p is not None and change.pressure is not None:
            p.x.array[:] += shift * change.pressure.x.array
        nodes, wanted = solution.mesh_nodes, quantities
        if change.reference is not None:
            nodes = nodes + shift * change.reference.nodes
            wanted = list(carried(quantities, body, nodes))
        moved = replace(solution, mesh_nodes=nodes, u=solution.u + shift * change.u, displacement=u, pressure=p)
        given = change.reference and change.reference.given
        with (
            model.at(nodes, u, p),
            model.given_moved(given, shift),
            scene.parameters.moved(change.along, shift),
        ):
            return {name: np.array(v) for name, v in values_of(wanted, body, moved, fields).items()}

    of_law = has_kinks(model.job)
    with_kinks = {
        quantity.name
        for quantity in quantities
        if (of_law and quantity.fields) or quantity.reduce in _EXTREMES or _KINKS.search(quantity.of.source)
    }
    found: dict[str, dict[str, Value]] = {quantity.name: {} for quantity in quantities}
    for parameter, change in changes if found else ():
        step = _step(model, solution, parameter, change)
        values = [at(change, k * step) for k in POINTS]
        near = [at(change, k * SHORT * step) for k in POINTS] if with_kinks else []
        for name, by_key in found.items():
            slope = central_difference((v[name] for v in values), step)
            if name in with_kinks:
                short = central_difference((v[name] for v in near), SHORT * step)
                rounding = _ROUNDING * np.abs(near[0][name]) / (SHORT * step)
                agree = np.abs(slope - short) <= np.maximum(_AGREEING * np.abs(short), rounding)
                slope = np.where(agree, slope, short)
            by_key[parameter.key] = slope.tolist()
    return found


def has_kinks(job: Job) -> bool:
    """Return whether the energy of a law of the job has a discontinuous second derivative by its formula."""
    return any(_KINKS.search(getattr(law, "formula", "")) for law in job.laws.values())


def _step(model: Model, solution: Solution, parameter: Parameter, change: Change) -> float:
    """Length of the differences by the parameter (SI)."""
    comm = model.body.mesh.comm
    limits = [abs(parameter.value)] if parameter.value else []
    limits.append(change_limit(model, solution, change.displacement))
    if solution.pressure is not None and change.pressure is not None:
        p, dp = _largest(comm, solution.pressure), _largest(comm, change.pressure)
        limits += [p / dp] if p and dp else []
    if change.reference is not None:
        limits.append(change.reference.limit)
    least = min(limits)
    return STEP * (least if math.isfinite(least) else 1.0)


def change_limit(model: Model, solution: Solution, rate: fem.Function) -> float:
    """Return the change (SI) of a parameter by which the displacement (m), with that rate, would double; collective."""
    comm = model.body.mesh.comm
    u, du = _largest(comm, solution.displacement), _largest(comm, rate)
    return (u or _SMALL * model.body.length_scale) / du if du else math.inf


def _largest(comm: MPI.Intracomm, function: fem.Function) -> float:
    return float(comm.allreduce(float(np.abs(function.x.array).max(initial=0.0)), op=MPI.MAX))
