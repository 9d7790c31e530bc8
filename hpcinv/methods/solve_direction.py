"""The solution of a model in one direction, reported to an observer solve by solve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hpcinv.methods import method_for
from hpcinv.model.outcome import Outcome
from hpcinv.parallel.runtime import MPI
from hpcinv.solver.observer import Observer, SolvedDirection, SolveEvent

if TYPE_CHECKING:
    from dolfinx.fem import Function

    from hpcinv.effects import Direction
    from hpcinv.methods.initial_guess import Guess
    from hpcinv.solver.problem import Model
    from hpcinv.solver.step_report import Solve


@dataclass(frozen=True)
class Start:
    """What the solution in one direction begins with.

    Attributes:
        solution: displacement (m) and pressure (Pa; ``None`` in the displacement form) of a checkpoint; ``None`` for
            the unloaded body.
        load: share of the load under which that is a solution.
        solves: those that led to it.
        guess: where to begin at full load; without, or where that fails, at the unloaded body.
    """

    solution: tuple[Function, Function | None] | None = None
    load: float = 0.0
    solves: tuple[Solve, ...] = ()
    guess: Guess | None = None


def solve_direction(model: Model, direction: Direction, start: Start, observer: Observer) -> SolvedDirection:
    """Solve up to the full load, unless it cannot be reached or the observer asks to stop; collective."""
    comm = model.body.mesh.comm
    model.unknowns.state.x.array[:] = 0.0
    if start.solution is not None:
        model.set_solution(*start.solution)
    method = method_for(model, direction, observer)
    method.turned = sum(solve.turning_point for solve in start.solves)
    method.guess = start.guess
    observer.begun(direction, method.equilibrium.linear.used)
    solves, stopped = list(start.solves), False
    can_restart = start.load > 0 or any(map(method.can_restart_after, start.solves))
    for solve in method.solves(start.load, resumed=start.solution is not None):
        interrupted = solve.outcome is Outcome.INTERRUPTED
        if not interrupted:  # else the resumed run repeats it
            solves.append(solve)
        restartable = method.can_restart_after(solve)
        can_restart |= restartable
        event = SolveEvent(
            solve, tuple(solves), method.reached, restartable, model.largest_displacement(), method.min_mesh_J()
        )
        observer.solved(event)
        stopped = comm.allreduce(observer.stop_asked() or interrupted, op=MPI.LOR)
        if stopped:
            break
    equilibrium = method.equilibrium
    # If nothing was solved, PETSc has asked for nothing.
    unused = tuple(equilibrium.linear.options.unused()) if start.load != 1.0 else None
    model.release(equilibrium)
    used = equilibrium.linear.used
    found = SolvedDirection(direction, tuple(solves), method.reached, used, stopped, can_restart, unused)
    observer.ended(found)
    return found
