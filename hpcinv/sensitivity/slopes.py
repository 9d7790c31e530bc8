"""Slopes of quantities of interest along a known change of solution and parameters.

A quantity is an explicit function ``Q(u, p, θ)``: its derivative along ``(du, dp, dθ)`` needs no solve. By central
differences of fourth order with a step of 2⁻¹⁰ of the smallest of displacement, pressure and parameter, their error is
about 1e-12 of the slope, and 1e-13 of the quantity over what it changes by as the parameter doubles. A ``max`` or
``min`` has the slope at the node or point that attains it; where another takes over within the step, one in between.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem

from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh.source import Floats
from hpcinv.model.parameters import Direction
from hpcinv.parallel.runtime import MPI
from hpcinv.quantity.parameter_paths import POINTS, central_difference
from hpcinv.results.quantities_of_interest import Value, fields_for, values_of
from hpcinv.results.solution import Solution
from hpcinv.solver.problem import Model

_STEP = 2.0**-10
_SMALL = 1e-3  # displacement of an unloaded body that counts as much, relative to the body


@dataclass(frozen=True)
class Change:
    """Derivatives by one parameter (SI): of the scene's parameters (scaled), displacement (m) and pressure (Pa).

    ``u`` is that of the displacement at the local geometry nodes, (n, 3).
    """

    along: Direction
    displacement: fem.Function
    u: Floats
    pressure: fem.Function | None


def slopes(
    model: Model, solution: Solution, changes: Sequence[tuple[Parameter, Change]]
) -> dict[str, dict[str, Value]]:
    """Return derivatives (SI) of each quantity of interest, without reactions, by the parameters' keys.

    Collective; the mesh must lie as the solution's.
    """
    scene, body = model.scene(solution.direction), model.body
    quantities = [quantity for quantity in model.job.quantities if not quantity.is_reaction]
    scene.parameters.set_load(1.0)
    fields = fields_for(quantities, body, scene, model.scales)

    def at(change: Change, shift: float) -> dict[str, Floats]:
        u, p = solution.displacement.copy(), solution.pressure and solution.pressure.copy()
        u.x.array[:] += shift * change.displacement.x.array
        if p is not None and change.pressure is not None:
            p.x.array[:] += shift * change.pressure.x.array
        moved = replace(solution, u=solution.u + shift * change.u, displacement=u, pressure=p)
        with model.at(solution.mesh_nodes, u, p), scene.parameters.moved(change.along, shift):
            return {name: np.array(v) for name, v in values_of(quantities, body, moved, fields).items()}

    found: dict[str, dict[str, Value]] = {quantity.name: {} for quantity in quantities}
    for parameter, change in changes if found else ():
        step = _step(model, solution, parameter, change)
        values = [at(change, k * step) for k in POINTS]
        for name, by_key in found.items():
            by_key[parameter.key] = central_difference((v[name] for v in values), step).tolist()
    return found


def _step(model: Model, solution: Solution, parameter: Parameter, change: Change) -> float:
    """Derivative by the parameter (SI)."""
    comm, diagonal = model.body.mesh.comm, model.body.length_scale
    u, du = _largest(comm, solution.displacement), _largest(comm, change.displacement)
    limits = [abs(parameter.value)] if parameter.value else []
    if du:
        limits.append((u or _SMALL * diagonal) / du)
    if solution.pressure is not None and change.pressure is not None:
        p, dp = _largest(comm, solution.pressure), _largest(comm, change.pressure)
        limits += [p / dp] if p and dp else []
    return _STEP * min(limits, default=1.0)


def _largest(comm: MPI.Intracomm, function: fem.Function) -> float:
    return float(comm.allreduce(float(np.abs(function.x.array).max(initial=0.0)), op=MPI.MAX))
