"""Derivatives of an inverse solution by an error of the gaps between its given surfaces, and by their pressures.

A closure that finds pressures sets the gaps of the unloaded bodies: ``g = c - B u = g₀`` where pressures act. If all
given gaps ``c`` are larger by ``δ``, pressures and shape follow as

    K₀ du = Bᵀ dp,      B du = δ.

The tangent ``K = K₀ + Bᵀ ε B`` has the penalty ε. With its factors, ``dp`` follows by Uzawa's method,
``dp ← dp - ε (B du - δ)``, accelerated.

Without tractions, ``dp = -p``: penalties are lowered so far that ``K`` is ``K₀``.

Source: Simo & Laursen (1992), doi:10.1016/0045-7949(92)90540-G.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import SolveError
from hpcinv.mesh.source import Floats
from hpcinv.model.interfaces.accelerated import AcceleratedUpdates
from hpcinv.model.interfaces.pair import SurfacePair
from hpcinv.results.quantities_of_interest import evaluate
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.intervals.pressed_bodies import unit_of
from hpcinv.trust.sensitivity.followed_numbers import FollowedNumbers

_ERROR = 2.0**-10
"""Error of the gaps, in lengths of the body, where the job states none; results are proportional to it."""
_MOST = 30
"""Updates of the pressures. Raised, weakly held pressures are found after more substitutions."""
_SETTLED = 1e-4  # share of the error that may be left of the gaps
_LOWERED = 2.0**-60
"""Penalties by the ones of the solve. Raised, pressures answer a change of the shape; lowered, nothing changes."""


@dataclass(frozen=True)
class GapResponse:
    """What an error of the given gaps changes, to first order.

    Attributes:
        error: of the gaps (m).
        largest, place: largest change of a node's position (m), and that node of the given mesh (m).
        forces: change of the force on the first surface of each interface, relative to it.
        quantities: change and SI unit of the job's quantities that are numbers.
    """

    error: float
    largest: float
    place: Floats
    forces: Mapping[str, float]
    quantities: Mapping[str, tuple[float, str]]


def gap_response(equations: Equations, solution: Solution) -> GapResponse:
    """Return the response of an inverse solution; the equations are in it afterwards; collective.

    Raises:
        SolveError: on all ranks, if the tangent is singular, pressures do not settle, or contact alone holds a part.
    """
    equations.put(solution)
    weak_form = equations.weak_form("inverse")
    equilibrium = equations.equilibrium(weak_form)
    system = equilibrium.system
    system.set_load(1.0)
    system.locate_contacts()
    pairs = [pair for pair in weak_form.contacts.pairs if pair.assumes_pressure and pair.is_iterated]
    error = _error(pairs, equations)
    position, x = system.position(), system.rhs.duplicate()
    try:
        if weak_form.contacts.pins:
            raise SolveError("contact alone holds a part, whose place the gaps do not determine")
        numbers = FollowedNumbers(equations, solution, equilibrium)
        try:
            rates = _followed(equations, pairs, numbers, error, x)
        finally:
            numbers.destroy()
        ends = []
        for sign in (1.0, -1.0):
            moved = position.copy()
            moved.axpy(sign, x)
            system.set_state(moved)
            moved.destroy()
            state = equations.state()
            u = equations.unknowns.geometry_values(state.displacement)
            ends.append(replace(solution, displacement=state.displacement, pressure=state.pressure, u=u))
        system.set_state(position)
    finally:
        position.destroy()
        x.destroy()
        equations.release(equilibrium)
    moves = np.linalg.norm(ends[0].u - ends[1].u, axis=1) / 2
    node = int(moves.argmax()) if len(moves) else 0
    own = (float(moves.max(initial=0.0)), tuple(solution.current_nodes[node].tolist()) if len(moves) else ())
    largest, place = max(equations.body.mesh.comm.allgather(own))
    wanted = [q for q in solution.job.quantities if not q.is_reaction]
    values = [evaluate(wanted, equations.body, end, equations) for end in ends]
    equations.put(solution)
    forces = {
        pair.spec.between[0]: abs(float(pair.areas @ rate)) / max(float(pair.areas @ pair.pressures), 1e-300)
        for pair, rate in zip(pairs, rates, strict=True)
    }
    changes = {
        q.name: (abs(float(values[0][q.name]) - float(values[1][q.name])) / 2, unit_of(q, equations.body))  # type: ignore[arg-type]
        for q in wanted
        if isinstance(values[0][q.name], float)
    }
    return GapResponse(error * equations.scales.length, largest, np.array(place), forces, changes)


def unpressed_distance(equations: Equations, solution: Solution) -> tuple[float, Floats]:
    """Return the distance of an inverse solution from bodies without contact tractions, to first order; collective.

    Returns:
        Largest change of a node's position (m), and that node of the given mesh (m).

    Raises:
        SolveError: on all ranks, if the tangent is singular, or contact alone holds a part.
    """
    equations.put(solution)
    weak_form = equations.weak_form("inverse")
    equilibrium = equations.equilibrium(weak_form)
    system, unknowns = equilibrium.system, equations.unknowns
    system.set_load(1.0)
    system.locate_contacts()
    pairs = [pair for pair in weak_form.contacts.pairs if pair.assumes_pressure]
    b, x = system.rhs.duplicate(), system.rhs.duplicate()
    b.array[:] = sum(pair.forces_of(-pair.pressures, -pair.tangential) for pair in pairs)
    equations.supports.free(b.array)
    for pair in pairs:
        pair.scale_penalties(_LOWERED)
    try:
        if weak_form.contacts.pins:
            raise SolveError("contact alone holds a part, so pressure balances its loads")
        numbers = FollowedNumbers(equations, solution, equilibrium)
        try:
            numbers.solve(b, np.zeros(numbers.count), x)
        finally:
            numbers.destroy()
        moves = np.linalg.norm(x.array[unknowns.owned_displacement_dofs].reshape(-1, 3), axis=1)
    finally:
        for pair in pairs:
            pair.scale_penalties(1 / _LOWERED)
        b.destroy()
        x.destroy()
        equations.release(equilibrium)
    length, points = equations.scales.length, unknowns.owned_displacement_points()
    node = int(moves.argmax()) if len(moves) else 0
    own = (float(moves[node]), tuple(points[node].tolist())) if len(moves) else (0.0, ())
    largest, place = max(equations.body.mesh.comm.allgather(own))
    if not largest <= equations.body.length:
        raise SolveError("contact alone holds a part, or its tractions act far beyond small changes")
    return largest * length, np.array(place) * length


def _error(pairs: Sequence[SurfacePair], equations: Equations) -> float:
    """Return the error of the gaps (scaled): what the job states, or a share of the body."""
    stated = [pair.spec.touches_within for pair in pairs if pair.spec.touches_within]
    return max(stated) / equations.scales.length if stated else _ERROR * equations.body.length


def _followed(
    equations: Equations, pairs: Sequence[SurfacePair], numbers: FollowedNumbers, error: float, x: PETSc.Vec
) -> list[Floats]:
    """Set ``x`` to the change of the state; return the changes of the pressures of each interface (scaled)."""
    b, updates = x.duplicate(), AcceleratedUpdates()
    acts = [pair.finds_at for pair in pairs]
    active, rates = np.concatenate(acts), [np.zeros(len(a)) for a in acts]
    starts = np.cumsum([len(a) for a in acts])[:-1]
    left = np.inf
    for _ in range(_MOST):
        forces = np.zeros(b.local_size)
        for pair, rate, a in zip(pairs, rates, acts, strict=True):
            trial = np.where(a, rate + pair.penalties * error, 0.0)
            forces += pair.forces_of(trial, np.zeros((len(trial), 3)))
        b.array[:] = forces
        equations.supports.free(b.array)
        numbers.solve(b, np.zeros(numbers.count), x)
        rest = [np.where(a, pair.jumps(x) - error, 0.0) for pair, a in zip(pairs, acts, strict=True)]
        left = max(float(np.abs(r).max(initial=0.0)) for r in rest)
        change = np.concatenate([-pair.penalties * r for pair, r in zip(pairs, rest, strict=True)])
        if left <= _SETTLED * error:
            break
        rates = np.split(updates.after(np.concatenate(rates), change, active), starts)
    b.destroy()
    rates = np.split(np.concatenate(rates) + change, starts)
    if equations.body.mesh.comm.allreduce(left, op=MPI.MAX) > _SETTLED * error:
        raise SolveError("the pressures that follow the gaps do not settle")
    return rates
