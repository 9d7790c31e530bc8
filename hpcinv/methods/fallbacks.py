"""The direct method where the job's strategy fails: other ways to the full load, one after the other.

They are tried in the order that the job has them in, by default

============  =========================================================================================================
bulk-modulus  for nearly incompressible bodies in the displacement form: the load on a softer material, then stiffened
arc-length    along the path of solutions in steps of its own length, from the last one known
line-search   a new tangent and PETSc's l2 line search in each of Newton's iterations, from the last solution known
anderson      for inverse problems: a fixed point of forward solves, from which Newton's method ends
============  =========================================================================================================

Each may take `EFFORT` factorizations. Where a turning point of the load seems to lie ahead, arc-length continuation is
tried before small steps are. Nothing is tried where it would be in vain: where the load has a turning point, where the
first tangent is singular, and where the discrete equations have a solution that no body can be in.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING

from hpcinv.methods.bulk_modulus import BulkModulus
from hpcinv.methods.fixed_point import FixedPointMethod
from hpcinv.model.outcome import Outcome
from hpcinv.solver.arc_length import ArcLengthSteps
from hpcinv.solver.equilibrium import Solve
from hpcinv.solver.load_stepping import AdaptiveSteps, FixedSteps, Steps, follow

if TYPE_CHECKING:
    from hpcinv.effects import Direction
    from hpcinv.solver.equilibrium import Equilibrium
    from hpcinv.solver.observer import Observer
    from hpcinv.solver.problem import Model

EFFORT = {"bulk-modulus": 150, "arc-length": 80, "load steps": 100, "line-search": 50, "anderson": 100}

type Solves = Generator[Solve, None, None]


@dataclass(frozen=True)
class Problem:
    """A direction to be solved, and its equations, whose state is a solution at the load reached so far."""

    model: Model
    direction: Direction
    equilibrium: Equilibrium
    observer: Observer


def reach(problem: Problem, steps: Steps, *, load: float = 0.0, turned: int = 0) -> Iterator[Solve]:
    """Yield every solve of the job's strategy, and of what is tried where that fails, as `follow` does.

    Args:
        load: load factor at which the present state is a solution.
        turned: turning points of the load on the way to it.
    """
    solver, last = problem.model.job.solver, None
    patient = "arc-length" not in solver.rescue
    for last in follow(problem.equilibrium, steps, solver.tolerance, load=load, turned=turned, patient=patient):
        load = last.load if last.outcome.accepted else load
        turned += last.turning_point
        yield last
    if isinstance(steps, FixedSteps) or last is None:
        return
    early = not patient and isinstance(steps, AdaptiveSteps) and last.load - load >= 2 * steps.least
    for name in _order(solver.rescue, early=early):
        if last.outcome.accepted or turned or _in_vain(last, load):
            return
        for last in _limited(RESCUES[name](problem, steps, load), EFFORT[name]):
            load = last.load if last.outcome.accepted else load
            turned += last.turning_point
            yield replace(last, strategy=name)


def _order(rescue: Sequence[str], *, early: bool) -> Sequence[str]:
    """What to try; where load steps ended early, at signs of a turning point, that is looked for first."""
    if not early:
        return rescue
    return ["arc-length", "load steps", *(name for name in rescue if name != "arc-length")]


def _in_vain(solve: Solve, load: float) -> bool:
    if solve.outcome is Outcome.VOLUME_CHANGED:
        return load > 0
    if solve.outcome is Outcome.LINEAR_SOLVER:
        return load == 0
    if solve.outcome is Outcome.KRYLOV_LIMIT:  # which the others would take as well
        return True
    if solve.outcome is Outcome.NOT_FINITE:  # a load that exceeds all numbers
        return load == 0 and not solve.factorizations
    return solve.outcome in (Outcome.INTERRUPTED, Outcome.LIMIT_POINT)


def _arc_length(problem: Problem, steps: Steps, load: float) -> Solves:
    if isinstance(steps, AdaptiveSteps):
        first, least = min(4 * steps.smallest, 1.0), steps.smallest / 256
        arcs = ArcLengthSteps(first, least, most=100, cases=steps.cases)
        yield from follow(problem.equilibrium, arcs, problem.model.job.solver.tolerance, load=load)


def _load_steps(problem: Problem, steps: Steps, load: float) -> Solves:
    """Those of the job, from small ones on."""
    if isinstance(steps, AdaptiveSteps):
        small = replace(steps, first=min(16 * steps.smallest, 1.0))
        yield from follow(problem.equilibrium, small, problem.model.job.solver.tolerance, load=load)


def _line_search(problem: Problem, steps: Steps, load: float) -> Solves:
    solver = problem.model.job.solver
    chosen = "basic" if solver.petsc.get("snes_linesearch_type") == "l2" else "l2"
    first, least = min(16 * solver.minimum_step, 1.0), solver.minimum_step / 16
    with problem.equilibrium.newton(chosen):
        cut = AdaptiveSteps(first, least, cases=steps.cases)
        yield from follow(problem.equilibrium, cut, solver.tolerance, load=load)


def _bulk_modulus(problem: Problem, steps: Steps, load: float) -> Solves:
    rescue = BulkModulus(problem.model, problem.equilibrium)
    if rescue.suits:
        yield from _as_one(problem, rescue.solves(), EFFORT["bulk-modulus"])


def _anderson(problem: Problem, steps: Steps, load: float) -> Solves:
    if problem.direction == "inverse":
        yield from _as_one(problem, _fixed_point(problem), EFFORT["anderson"])


def _fixed_point(problem: Problem) -> Solves:
    """Solves of the fixed-point method, to a tolerance from which the last one, of the inverse problem, converges."""
    job = problem.model.job
    near = job.fixed_point.model_copy(update={"tolerance": 1e-3, "maximum_iterations": 20})
    model = copy.copy(problem.model)
    model.job = job.model_copy(update={"method": "anderson", "fixed_point": near})
    model.unknowns.state.x.array[:] = 0.0
    method = FixedPointMethod(model, problem.observer)
    try:
        for solve in method.solves(0.0, resumed=False):
            yield solve
    finally:
        method.equilibrium.destroy()
    if solve.outcome.accepted:
        yield problem.equilibrium.solve(1.0, job.solver.tolerance)


RESCUES: Mapping[str, Callable[[Problem, Steps, float], Solves]] = {
    "bulk-modulus": _bulk_modulus,
    "arc-length": _arc_length,
    "load steps": _load_steps,
    "line-search": _line_search,
    "anderson": _anderson,
}


def _limited(solves: Solves, effort: int) -> Solves:
    """Solves until they have taken too many factorizations."""
    spent = 0
    with closing(solves):
        for solve in solves:
            yield solve
            spent += solve.factorizations
            if spent > effort and not (solve.outcome.accepted and solve.load == 1.0):
                yield Solve(solve.load, Outcome.STEP_LIMIT, (), 0)
                return


def _as_one(problem: Problem, solves: Solves, effort: int) -> Solves:
    """The solves of a way on which no state but the last is a solution of the problem, reported as one."""
    start = problem.equilibrium.system.position()
    taken = list(_limited(solves, effort))
    last = taken[-1]
    if not last.outcome.accepted:
        problem.equilibrium.system.set_state(start)
    iterations = tuple(i for solve in taken for i in solve.iterations)
    yield Solve(1.0, last.outcome, iterations, sum(s.factorizations for s in taken), last.signs)


@dataclass(frozen=True)
class Attempt:
    """Solves of one strategy in one direction.

    Attributes:
        strategy: ``load steps``, ``arc-length``, or another of `RESCUES`.
        load: load factor of its last accepted solve, ``None`` if there is none.
        outcome: of its last solve.
        solves, iterations, factorizations: what it took.
    """

    strategy: str
    load: float | None
    outcome: Outcome
    solves: int
    iterations: int
    factorizations: int


def attempts(solves: Sequence[Solve]) -> list[Attempt]:
    """The strategies tried in one direction, in order; only the last one can have reached the full load."""
    found = []
    for strategy, group in groupby(solves, key=lambda solve: solve.strategy):
        own = list(group)
        reached = [s.load for s in own if s.outcome.accepted]
        found.append(
            Attempt(
                strategy,
                reached[-1] if reached else None,
                own[-1].outcome,
                len(own),
                sum(len(s.iterations) for s in own),
                sum(s.factorizations for s in own),
            )
        )
    return found
