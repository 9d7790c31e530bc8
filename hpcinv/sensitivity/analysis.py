"""Sensitivities of a solution: one linear solve with its tangent for each parameter.

The solution of ``R(x; θ) = 0`` follows a parameter as ``K dx/dθ = -∂R/∂θ``, with the tangent ``K = ∂R/∂x`` at the
solution: exact derivatives of the discrete solution. Unknowns that supports prescribe follow their formulas. In an
inverse analysis, where ``X = x - u`` and x is given, ``dX/dθ = -du/dθ``.

To first order, what is made of independent parameters with standard deviations σ has ``sd² = Σ (dQ/dθ σ)²``.

Source: Tortorelli & Michaleris, "Design sensitivity analysis: overview and review" (1994),
doi:10.1080/174159794088027573; JCGM 100:2008, *Guide to the expression of uncertainty in measurement*, 5.1.2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import dolfinx.fem.petsc as fem_petsc
import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.errors import SolveError
from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh.source import Floats
from hpcinv.parallel.runtime import MPI
from hpcinv.quantity.component import Ingredient
from hpcinv.results.quantities_of_interest import Value
from hpcinv.results.solution import Solution
from hpcinv.sensitivity.slopes import Change, slopes
from hpcinv.solver.problem import Model


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives of one solution by parameters (SI), and standard deviations to first order.

    Attributes:
        slopes: of each quantity of interest but reactions by parameter, a list of 3 for a vector.
        displacement: of ``u = x - X``, by parameter.
        nodes: of the body that was looked for, at the local geometry nodes, (n, 3), by parameter.
        shape: largest length of those over all nodes.
        deviations: of each quantity, ``None`` if no parameter has one.
        deviation: of the shape, at the node where it is largest: ``√(Σ |dX/dθ|² σ²)`` in m, ``None`` likewise.
        deviation_at: position of that node in the given body (m).
    """

    parameters: Sequence[Parameter]
    slopes: Mapping[str, Mapping[str, Value]]
    displacement: Mapping[str, fem.Function]
    nodes: Mapping[str, Floats]
    shape: Mapping[str, float]
    deviations: Mapping[str, Value | None]
    deviation: float | None
    deviation_at: list[float] | None

    def as_data(self) -> dict[str, Any]:
        """Return JSON data, without the fields."""
        return {
            "parameters": {p.key: {"value": p.value, "sd": p.deviation} for p in self.parameters},
            "quantities": {
                name: {"slopes": dict(by_key), "sd": self.deviations[name]} for name, by_key in self.slopes.items()
            },
            "shape": {"largest": dict(self.shape), "sd": self.deviation, "sd_at": self.deviation_at},
        }

    def fields(self) -> list[fem.Function]:
        """Return fields for ParaView: ``d displacement/d KEY`` and, if known, the standard deviation ``sd`` in m."""
        found = []
        for key, function in self.displacement.items():
            named = function.copy()
            named.name = f"d displacement/d {key}"
            found.append(named)
        if self.deviation is not None:
            space = found[0].function_space
            scalar = fem.functionspace(space.mesh, ("Lagrange", space.ufl_element().degree))
            deviation = fem.Function(scalar, name="sd")
            vectors = {key: function.x.array.reshape(-1, 3) for key, function in self.displacement.items()}
            deviation.x.array[:] = _deviations(self.parameters, vectors)
            found.append(deviation)
        return found


def sensitivities(model: Model, solution: Solution) -> Sensitivities | None:
    """Differentiate a solution at full load by the job's parameters; ``None`` if there are none; collective.

    Raises:
        SolveError: on all ranks, if the tangent at the solution is singular.
    """
    parameters, body = model.job.differentiated, model.body
    if not parameters:
        return None
    with model.timings("sensitivities"), model.at(solution.mesh_nodes, *solution.fields):
        changes = _changes(model, solution, parameters)
        by_quantity = slopes(model, solution, [(p, changes[p.key]) for p in parameters])
    nodes = {key: solution.sign * change.u for key, change in changes.items()}
    comm = body.mesh.comm
    lengths = {key: np.linalg.norm(moved, axis=1) for key, moved in nodes.items()}
    deviation, at = None, None
    if any(p.deviation is not None for p in parameters):
        deviation, at = _largest(comm, _deviations(parameters, nodes), solution.mesh_nodes)
    return Sensitivities(
        parameters=parameters,
        slopes=by_quantity,
        displacement={key: change.displacement for key, change in changes.items()},
        nodes=nodes,
        shape={key: _largest(comm, length, solution.mesh_nodes)[0] for key, length in lengths.items()},
        deviations={name: _deviation(parameters, found) for name, found in by_quantity.items()},
        deviation=deviation,
        deviation_at=at,
    )


def _changes(model: Model, solution: Solution, parameters: Sequence[Parameter]) -> dict[str, Change]:
    """Return the derivatives of the solution and of the scene's parameters, by the key of the job's parameter."""
    scene = model.scene(solution.direction)
    equilibrium = model.equilibrium(scene)
    system = equilibrium.system
    system.linearise(1.0)
    with model.timings("compile"):
        derivative = scene.parameter_derivative
    position, b, x = system.position(), system.rhs.duplicate(), system.rhs.duplicate()
    found: dict[str, Change] = {}
    for parameter in parameters:
        owner, place = parameter.owner, parameter.place
        if isinstance(owner, Ingredient):
            local = parameter.where.removeprefix(model.job.place("effects").removesuffix("effects"))
            along = scene.parameters.direction({local: owner.rates(place)})
            with model.timings("residual"):
                derivative.assemble(along, b)
                b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
                fem_petsc.set_bc(b, model.supports.conditions, alpha=0.0)
                b.scale(-1.0)
        else:
            along = scene.parameters.direction({})
            number = model.job.supports.index(owner)
            model.supports.prescribe_rates(number, partial(owner.with_number, place), parameter.value)
            system.lift(b)
            model.supports.scale(1.0)
        if not equilibrium.linear.solve(b, x):
            raise SolveError(
                "sensitivities: the tangent at the solution is singular, so that there are no derivatives there",
                "Leave the section 'sensitivities' out, or take a load at which the solution is not at a limit point.",
            )
        system.set_state(x)
        u, p = model.solution()
        found[parameter.key] = Change(along, u, model.unknowns.at_nodes(u), p)
        system.set_state(position)
    for vector in (position, b, x):
        vector.destroy()
    model.release(equilibrium)
    return found


def _deviations(parameters: Sequence[Parameter], vectors: Mapping[str, Floats]) -> Floats:
    """Return standard deviations (n,) of the lengths of vectors (n, 3) with these derivatives."""
    squares = [(vectors[p.key] ** 2).sum(axis=1) * p.deviation**2 for p in parameters if p.deviation is not None]
    return np.asarray(np.sqrt(sum(squares)))


def _deviation(parameters: Sequence[Parameter], by_key: Mapping[str, Value]) -> Value | None:
    parts = [np.array(by_key[p.key]) * p.deviation for p in parameters if p.deviation is not None]
    if not parts:
        return None
    found = np.linalg.norm(parts, axis=0)
    return [float(v) for v in found] if found.ndim else float(found)


def _largest(comm: MPI.Intracomm, values: Floats, points: Floats) -> tuple[float, list[float]]:
    """Return the largest value over all ranks, and its point (m)."""
    here = int(values.argmax()) if len(values) else None
    mine = None if here is None else (float(values[here]), [float(c) for c in points[here]])
    everywhere: list[tuple[float, list[float]] | None] = comm.allgather(mine)
    return max(found for found in everywhere if found is not None)
