"""Contact tractions for which the given shape stores the least elastic energy.

The tractions are searched among all that the shape admits (`hpcinv.trust.intervals.admissible_tractions`). Each step
solves a quadratic program: the energy has the slopes of the present body, and the curvature of a linear one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np

from hpcinv.errors import SolveError
from hpcinv.job.job import Job, PlannedSolve
from hpcinv.mesh.source import Floats
from hpcinv.results.solution import solution_of
from hpcinv.results.steps import StepControl
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods import solve_direction
from hpcinv.solver.methods.method import UNLOADED
from hpcinv.solver.newton import CoarseSolve
from hpcinv.solver.observer import SolvedDirection
from hpcinv.trust.intervals.pressed_bodies import Pressed, PressedBodies
from hpcinv.trust.intervals.quadratic_program import solve_quadratic
from hpcinv.trust.intervals.stored_energy import StoredEnergy

_MOST = 20
"""Steps of the search; bodies of rubber take 3 to 6. Raised, searches that do not settle take longer."""
_SETTLED = 1e-7
"""Share of the energy that one more step may promise. Lowered, errors of its slopes prevent an end."""
_DEPTH = 1e-6  # overlap that is tolerated, in lengths of the body


def solve_least_energy(
    step: PlannedSolve, equations: Equations, control: StepControl
) -> tuple[SolvedDirection, CoarseSolve | None]:
    """Solve a step whose interfaces have the closure; the equations are in its solution then; collective.

    The search begins with the solution of another closure.

    Raises:
        SolveError: on all ranks, if no tractions are admissible, or the search does not settle.
    """
    begun = Equations(_begun(step.job), equations.body, equations.timings, equations)
    begun.put(replace(equations.state(), job=begun.job))
    solved = solve_direction(begun, step.direction, UNLOADED, control.solves)
    if solved.stopped or solved.load < 1.0:
        begun.destroy()
        return solved, None
    weak_form = begun.weak_form(step.direction)
    solution = solution_of(begun, step.direction, weak_form, solved.solves, solved.load, solved.linear)
    bodies = PressedBodies(begun, solution, with_energy=True)
    try:
        found = _least(bodies, begun.body.length, control)
    finally:
        bodies.destroy()
        begun.destroy()
    equations.put(replace(found.solution, job=step.job))
    return solved, None


def _begun(job: Job) -> Job:
    """Return a job with the closures with which the search begins, and without quantities."""

    def first(interface: Any) -> Any:
        names = interface.assumed.searched_from if interface.assumed else {}
        name = names.get("with" if interface.friction else "without")
        return interface if name is None else interface.model_copy(update={"closure": name})

    return job.model_copy(update={"interfaces": tuple(map(first, job.interfaces)), "quantities": ()})


def _least(bodies: PressedBodies, length: float, control: StepControl) -> Pressed:
    """Return the body of least energy; collective."""
    body, share = bodies.at_start, 1.0
    for count in range(_MOST):
        change, energy = _change(bodies, body), _energy(body)
        model = energy.slopes @ change + change @ energy.curvature @ change / 2
        control.note(f"step {count + 1}: energy {energy.value:.6g} in scaled units, promised change {model:.2e}")
        if -model <= _SETTLED * energy.value and body.near.depth <= _DEPTH * length:
            return body
        following = bodies.solved(body.near.values + share * change)
        is_better = _energy(following).value < energy.value or following.near.depth < body.near.depth
        is_better |= count == 0  # tractions of the other closure need not be within the friction cone
        share = 1.0 if is_better else share / 2
        body = following if is_better else body
    raise SolveError(
        f"contact of least energy: the search has not settled after {_MOST} steps", "Assume 'closure: conforming'."
    )


def _energy(body: Pressed) -> StoredEnergy:
    """Return the energy of a body of this search, all of which have it."""
    return cast(StoredEnergy, body.energy)


def _change(bodies: PressedBodies, body: Pressed) -> Floats:
    """Return the change of the tractions to the least energy near a body; found on one rank."""
    found: Any = None
    if bodies.comm.rank == 0:
        near, energy = body.near, _energy(body)
        rows, limits = near.rows(near.values)
        found = solve_quadratic(energy.curvature, energy.slopes, (rows, limits), near.balance)
    found = bodies.comm.bcast(found)
    if found is None:
        raise SolveError(
            "contact of least energy: no unloaded bodies were found that do not overlap, have no negative pressure"
            " and agree with what is 'known'",
            "Check travel and segmentation; 'uncertainty: contact' says what is missing.",
        )
    change: Floats = np.asarray(found)
    return change
