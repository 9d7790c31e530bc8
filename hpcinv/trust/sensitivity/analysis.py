"""Sensitivities of a solution: one linear solve with its tangent for each parameter.

The solution of ``R(x; θ) = 0`` follows a parameter as ``K dx/dθ = -∂R/∂θ``, with the tangent ``K = ∂R/∂x`` at the
solution: exact derivatives of the discrete solution. Unknowns that supports prescribe follow their formulas. In an
inverse analysis, where ``X = x - u`` and x is given, ``dX/dθ = -du/dθ``. Unknown pressures of cavities and motions
under remote loads follow with x from their equations (`hpcinv.trust.sensitivity.followed_numbers`).

A further state is solved on the reference shape X, which follows the parameters of the given state; what is given on
the current body follows the displacement u₀ there: ``K dx/dθ = -∂R/∂θ - ∂R/∂X dX/dθ - ∂R/∂u₀ du₀/dθ``. The last two
are central differences of the residual of fourth order.

To first order, what is made of independent parameters with standard deviations σ has ``sd² = Σ (dQ/dθ σ)²``.

Source: Tortorelli & Michaleris, "Design sensitivity analysis: overview and review" (1994),
doi:10.1080/174159794088027573; JCGM 100:2008, *Guide to the expression of uncertainty in measurement*, 5.1.2.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from types import MappingProxyType

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.parameter_paths import POINTS, central_difference
from hpcinv.job.job import Job
from hpcinv.job.quantity_of_interest import QuantityValue
from hpcinv.job.sensitivities import Parameter, tied_parameters
from hpcinv.job.support import Support
from hpcinv.mesh import Body
from hpcinv.mesh.body import local_node_values
from hpcinv.mesh.kind_source import source_of
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.model.parameters import ParameterDirection
from hpcinv.on_demand import on_demand
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.sensitivity.followed_numbers import FollowedNumbers
from hpcinv.trust.sensitivity.sensitivities import Sensitivities, deviation_of, deviations_of
from hpcinv.trust.sensitivity.slopes import SHORT, STEP, Change, ReferenceChange, change_limit, has_kinks, slopes


def _references(
    equations: Equations,
    numbers: Sequence[Parameter],
    first: tuple[Solution, Sensitivities] | None,
    mesh: Mapping[str, Floats],
) -> dict[str, ReferenceChange]:
    """Return the changes of the reference shape by the keys of the numbers; arguments as of `sensitivities`."""
    if first:
        return {p.key: _reference(equations, p, *first) for p in numbers}
    references = {key: ReferenceChange(moved, None, _cell_limit(equations, moved)) for key, moved in mesh.items()}
    values = {p.key: p.value for p in numbers}
    rates = node_rates(equations.job, equations.body, numbers)
    return references | {key: ReferenceChange(moved, None, values[key]) for key, moved in rates.items()}


def _is_motion(parameter: Parameter, job: Job) -> bool:
    """Return whether a parameter is of a prescribed motion of a job's support."""
    owner = parameter.owner
    return isinstance(owner, Support) and owner.remote is None and parameter.where in job.owners


def sensitivities(
    equations: Equations,
    solution: Solution,
    parameters: Sequence[Parameter],
    first: tuple[Solution, Sensitivities] | None = None,
    mesh: Mapping[str, Floats] = MappingProxyType({}),
) -> Sensitivities:
    """Differentiate a solution at full load by parameters of the job; collective.

    Args:
        first: for a further state, solution and derivatives of the given state, which determines the reference shape.
        mesh: for the first solve, derivatives (n, 3) of its local geometry nodes by those parameters that move these.

    Raises:
        SolveError: on all ranks, if the tangent at the solution is singular.
    """
    body, numbers = equations.body, tied_parameters(parameters)
    equations.put(solution.moved_to(body.given_nodes))
    with equations.timings("sensitivities"):
        references = _references(equations, numbers, first, mesh)
        prescribed = {p.key: _prescribed(equations, p) for p in numbers if _is_motion(p, equations.job)}
        equations.put(solution)
        changes, assumption = _changes(equations, solution, numbers, references, prescribed)
        quantity_slopes = {
            name: _summed(parameters, key_slopes)
            for name, key_slopes in slopes(equations, solution, [(p, changes[p.key]) for p in numbers]).items()
        }
    nodes = {p.key: _moved_nodes(p, changes, references, solution.sign) for p in parameters}
    comm = body.mesh.comm
    lengths = {key: np.linalg.norm(moved, axis=1) for key, moved in nodes.items()}
    deviation, point = None, None
    if any(p.deviation is not None for p in parameters):
        deviation, point = _largest(comm, deviations_of(parameters, nodes), solution.mesh_nodes)
    return Sensitivities(
        parameters=parameters,
        slopes=quantity_slopes,
        displacement={p.key: _displacement(p, changes) for p in parameters},
        nodes=nodes,
        shape={key: _largest(comm, length, solution.mesh_nodes)[0] for key, length in lengths.items()},
        deviations={name: deviation_of(parameters, key_slopes) for name, key_slopes in quantity_slopes.items()},
        deviation=deviation,
        deviation_at=point,
        assumption=assumption,
    )


def _summed(parameters: Sequence[Parameter], key_slopes: Mapping[str, QuantityValue]) -> dict[str, QuantityValue]:
    """Add to the slope by each parameter those by its ties."""
    return {
        p.key: sum(number.ratio * np.array(key_slopes[number.key]) for number in (p, *p.ties)).tolist()  # type: ignore[union-attr]
        for p in parameters
    }


def _moved_nodes(
    parameter: Parameter, changes: Mapping[str, Change], references: Mapping[str, ReferenceChange], sign: float
) -> Floats:
    """Return the derivative (n, 3) of the nodes of the computed body by a parameter and its ties."""
    numbers = (parameter, *parameter.ties)
    moved = np.asarray(sign * sum(number.ratio * changes[number.key].u for number in numbers))
    for number in numbers:
        if number.key in references:
            moved += number.ratio * references[number.key].nodes
    return moved


def _displacement(parameter: Parameter, changes: Mapping[str, Change]) -> fem.Function:
    first = changes[parameter.key].displacement
    if not parameter.ties:
        return first
    whole = first.copy()
    for tie in parameter.ties:
        whole.x.array[:] += tie.ratio * changes[tie.key].displacement.x.array
    return whole


def _cell_limit(equations: Equations, moved: Floats) -> float:
    """Change of a parameter by which a node would move by the smallest cell's size, collective."""
    mesh = equations.body.mesh
    sizes = mesh.h(3, np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32))
    smallest = mesh.comm.allreduce(float(sizes.min(initial=math.inf)), op=MPI.MIN) * equations.body.length_scale
    largest = mesh.comm.allreduce(float(np.abs(moved).max(initial=0.0)), op=MPI.MAX)
    return smallest / largest if largest else math.inf


def _prescribed(equations: Equations, parameter: Parameter) -> list[Floats]:
    """Rates of the prescribed displacements, whose formulas are of positions in the given mesh."""
    owner = parameter.owner
    assert isinstance(owner, Support)
    number = equations.job.supports.index(owner)
    replaced, direction = partial(owner.number_replaced, parameter.place), equations.job.directions[0]
    return equations.supports.rates(number, replaced, parameter.value, direction)


def _reference(
    equations: Equations, parameter: Parameter, solution: Solution, derivatives: Sensitivities
) -> ReferenceChange:
    """Derivatives of what a further state takes from the given one, whose solution and derivatives are known."""
    key = parameter.key
    if key not in derivatives.nodes:  # a tie, whose effect is part of its parameter's
        nothing = fem.Function(solution.displacement.function_space)
        return ReferenceChange(np.zeros_like(solution.mesh_nodes), nothing, math.inf)
    displacement, nodes = derivatives.displacement[key], derivatives.nodes[key]
    return ReferenceChange(nodes, displacement, change_limit(equations, solution, displacement))


def _changes(
    equations: Equations,
    solution: Solution,
    parameters: Sequence[Parameter],
    references: Mapping[str, ReferenceChange],
    prescribed: Mapping[str, Sequence[Floats]],
) -> tuple[dict[str, Change], str]:
    """Return derivatives of the solution and of the parameters of the weak form, by the key of the job's parameter.

    Returns:
        Also what they assume of contacts, in words; empty without any.
    """
    weak_form = equations.weak_form(solution.direction)
    equilibrium = equations.equilibrium(weak_form)
    system = equilibrium.system
    system.set_load(1.0)
    followed = on_demand("settled contacts") if weak_form.contacts.pairs else FollowedNumbers
    numbers: FollowedNumbers = followed(equations, solution, equilibrium)
    position, b, x = system.position(), system.rhs.duplicate(), system.rhs.duplicate()
    changes: dict[str, Change] = {}
    for parameter in parameters:
        direction, by_parameter = _explicit(equations, system, numbers, parameter, prescribed, b)
        if (reference := references.get(parameter.key)) is not None:
            x.array[:], by_mesh = _rates_with_mesh(equations, system, numbers, solution, reference)
            equations.supports.free(x.array)
            b.axpy(-1.0, x)
            by_parameter = by_parameter + by_mesh
        found = numbers.solve(b, by_parameter, x)
        system.set_state(x)
        u, p = equations.state().fields
        changes[parameter.key] = Change(direction, u, equations.unknowns.geometry_values(u), p, reference, found)
        system.set_state(position)
    numbers.destroy()
    for vector in (position, b, x):
        vector.destroy()
    equations.release(equilibrium)
    return changes, numbers.assumption


def _explicit(
    equations: Equations,
    system: System,
    numbers: FollowedNumbers,
    parameter: Parameter,
    prescribed: Mapping[str, Sequence[Floats]],
    b: PETSc.Vec,
) -> tuple[ParameterDirection, Floats]:
    """Set ``b`` to the right-hand side for a parameter.

    Returns:
        Direction in which it moves the parameters, and derivatives of the equations of the unknown numbers by it.
    """
    owner, place, job, weak_form = parameter.owner, parameter.place, equations.job, system.weak_form
    unchanged = weak_form.parameters.direction({})
    b.set(0.0)
    if parameter.key in prescribed:
        system.lift_rates(b, prescribed[parameter.key], 1.0)
        return unchanged, numbers.rates(parameter)
    if not isinstance(owner, Ingredient) or parameter.where not in job.owners:  # or of another state
        return unchanged, numbers.rates(parameter)
    with equations.timings("programs"):
        derivative = weak_form.parameter_derivative
    local = parameter.where.removeprefix(job.place("effects").removesuffix("effects"))
    direction = weak_form.parameters.direction({local: owner.rates(place)})
    with equations.timings("residual"):
        derivative.assemble(direction, b)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        by_parameter = numbers.rates(parameter) + numbers.force_rates(b.array)
        equations.supports.free(b.array)
        b.scale(-1.0)
    return direction, by_parameter


def _rates_with_mesh(
    equations: Equations, system: System, numbers: FollowedNumbers, solution: Solution, reference: ReferenceChange
) -> tuple[Floats, Floats]:
    """Return changes with the reference shape, per unit of the parameter.

    These are changes of the nodal forces (scaled) of the owned unknowns, and of the equations of the unknown numbers.
    """
    if not math.isfinite(reference.limit):
        return np.zeros(system.rhs.local_size), np.zeros(numbers.count)
    step = reference.limit * (STEP * SHORT if has_kinks(equations.job) else STEP)

    def values(number: int) -> Floats:
        equations.put(reference.moved(solution, number * step))
        return np.concatenate([system.forces(1.0), numbers.equations()])

    rates = np.asarray(central_difference(map(values, POINTS), step))
    equations.put(solution)
    forces, by_mesh = np.split(rates, [len(rates) - numbers.count])
    return forces, by_mesh


def _largest(comm: MPI.Intracomm, values: Floats, points: Floats) -> tuple[float, list[float]]:
    """Return the largest value over all ranks, and its point (m)."""
    here = int(values.argmax()) if len(values) else None
    mine = None if here is None else (float(values[here]), [float(c) for c in points[here]])
    everywhere: list[tuple[float, list[float]] | None] = comm.allgather(mine)
    return max(entry for entry in everywhere if entry is not None)


def moves_nodes(parameter: Parameter, job: Job) -> bool:
    """Return whether a number moves the nodes of the given body, as the thickness of a shell does."""
    return parameter.owner in job.mesh.sections_of_kind.values()


def node_rates(job: Job, body: Body, parameters: Iterable[Parameter]) -> dict[str, Floats]:
    """Return derivatives (n, 3) of the local geometry nodes by those parameters that move them, by key; collective."""
    source = body.source
    kind, moving = source_of(source.body_kind), [p for p in parameters if moves_nodes(p, job)]
    return {p.key: local_node_values(body, kind.node_rates(source, p.place, p.value)) for p in moving}
