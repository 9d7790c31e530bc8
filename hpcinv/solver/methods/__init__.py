"""Solution methods: the direct method, and for inverse problems fixed-point methods with forward solves."""

from collections.abc import Sequence

from hpcinv.model.outcome import Outcome
from hpcinv.on_demand import on_demand
from hpcinv.physics.effects import Direction
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.methods.direct_method import DirectMethod
from hpcinv.solver.methods.method import Method, Start
from hpcinv.solver.newton import Solve, is_given_up
from hpcinv.solver.observer import SILENT, Observer, SolvedDirection, SolveEvent, is_stop_asked

_FAILURES = 4
"""Failed solves after which it is said what moves. Fewer would say it of jobs that only halve a first step."""


def method_for(equations: Equations, direction: Direction, observer: Observer = SILENT) -> Method:
    """Return the method of the equations' job; forward problems are always solved directly."""
    if direction == "forward" or equations.job.method == "direct":
        return DirectMethod(equations, direction, observer)
    method: Method = on_demand("fixed-point method")(equations, observer)
    return method


def solve_direction(equations: Equations, direction: Direction, start: Start, observer: Observer) -> SolvedDirection:
    """Solve up to the full load, until that fails or the observer asks to stop; collective."""
    comm = equations.body.mesh.comm
    equations.put_fields(start.solution)
    method = method_for(equations, direction, observer)
    observer.begun(direction, method.equilibrium.linear.used)
    solves, stopped = list(start.solves), False
    can_restart = start.load > 0 or any(map(method.can_restart_after, start.solves))
    failures = 0
    for solve in method.solves(start):
        interrupted = solve.outcome is Outcome.INTERRUPTED
        if not interrupted:  # the resumed run repeats an interrupted one
            solves.append(solve)
        restartable = method.can_restart_after(solve)
        can_restart |= restartable
        event = SolveEvent(
            solve,
            tuple(solves),
            method.reached_load,
            restartable,
            equations.largest_displacement(),
            method.min_mesh_J(),
        )
        observer.solved(event)
        stopped = is_stop_asked(comm, observer) or interrupted
        if stopped:
            break
        if solve.outcome.accepted:
            continue
        failures += 1
        ends = is_given_up(solves, equations.job.solver.patience)
        if failures == _FAILURES or (ends and failures < _FAILURES):
            _show_motion(equations, method, failures, observer)
        if ends:
            break
    equilibrium, load = method.equilibrium, method.reached_load
    _explain_sliding(equations, equilibrium, solves, observer)
    loads = method.unknown_loads if isinstance(method, DirectMethod) and load else None
    constraints = () if loads is None else loads.reports(load)
    # If nothing was solved, PETSc has used no options.
    unused = tuple(equilibrium.linear.options.unused()) if start.load != 1.0 else None
    equations.release(equilibrium)
    used = equilibrium.linear.used
    solved = SolvedDirection(
        direction, tuple(solves), method.reached_load, used, stopped, can_restart, unused, constraints
    )
    observer.ended(solved)
    return solved


def _show_motion(equations: Equations, method: Method, failures: int, observer: Observer) -> None:
    """Say what moves after so many failed solves; collective."""
    if isinstance(method, DirectMethod) and not method.equilibrium.numbers.count:
        motion = on_demand("motion after failures")
        observer.failing(motion(equations.job, equations.body, method.equilibrium, method.reached_load, failures))


def _explain_sliding(
    equations: Equations, equilibrium: Equilibrium, solves: Sequence[Solve], observer: Observer
) -> None:
    """Say whether friction can hold a body, if the last solve failed; collective."""
    if not solves or solves[-1].outcome.accepted or not equilibrium.system.weak_form.contacts.depends_on_path:
        return
    limit = on_demand("limit of friction")
    if lines := limit(equations.job, equilibrium.system, solves[-1].load, equations.scales):
        observer.failing(lines)


__all__ = ["DirectMethod", "Method", "method_for", "solve_direction"]
