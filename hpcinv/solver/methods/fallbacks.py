"""Fallbacks of the direct method: other strategies, tried in turn where the strategy of the job fails.

They are tried in the order of the job, by default

============  =========================================================================================================
bulk-modulus  for nearly incompressible bodies in the displacement form: the load on a softer material, then stiffened
arc-length    arc-length continuation from the last solution
line-search   a new tangent and PETSc's l2 line search in each of Newton's iterations, from the last solution
anderson      for inverse problems: a fixed point of forward solves, refined by Newton's method
============  =========================================================================================================

Each may take `EFFORT` factorizations. Where a limit point is likely, arc-length continuation is tried before small
steps. No fallback is tried where none can help: at a limit point of the load, where the first tangent is singular, and
where the discrete equations have a solution that no body can have.
"""

import math
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import groupby

from hpcinv.model.outcome import Outcome
from hpcinv.physics.effects import Direction
from hpcinv.physics.points.scalar_graph import NotAnalytic
from hpcinv.solver.arc_length import ArcLengthSteps
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.load_stepping import AdaptiveSteps, FixedSteps, SeriesSolver, Steps, follow
from hpcinv.solver.methods.bulk_modulus import BulkModulus
from hpcinv.solver.methods.fixed_point import FixedPointMethod
from hpcinv.solver.newton import Solve
from hpcinv.solver.observer import Observer
from hpcinv.solver.series_continuation import STRATEGY as SERIES
from hpcinv.solver.series_continuation import SeriesContinuation

EFFORT = {"bulk-modulus": 150, "arc-length": 80, "load steps": 100, "line-search": 50, "anderson": 100}

_LARGE = 10_000
"""Unknowns of a large body. Below, a series saves less than the time to compile its code for the first time. With
factors in single precision, as of slender bodies, load steps take factors again, and a series often takes new ones."""
_FARTHEST, _FARTHEST_COMPACT, _FARTHEST_SMALL = 0.3, 0.5, 300.0
"""Ratio of the first correction to the prediction, with the same factors, above which `auto` takes a series: on large,
compact and small bodies. Above 0.3, Newton's method makes new tangents, which earlier factors of a compact body can
solve up to about 0.5 and more. Above about 400 it fails."""

_WITH_NUMBERS = ("arc-length", "line-search")
"""Fallbacks that know of unknown pressures and motions."""

_SIDES = {"first": 0, "positive": 1, "negative": -1}

type Solves = Generator[Solve, None, None]


@dataclass(frozen=True)
class Problem:
    """A direction to solve, and its equations, whose state is a solution at the load reached so far."""

    equations: Equations
    direction: Direction
    equilibrium: Equilibrium
    observer: Observer


@dataclass
class _Reached:
    """Load and number of limit points that solves have reached, and the last of them."""

    load: float
    passed: int
    last: Solve | None = None

    def noting(self, solves: Iterable[Solve]) -> Iterator[Solve]:
        """Yield solves, and note what they reach."""
        for solve in solves:
            self.load = solve.load if solve.outcome.accepted else self.load
            self.passed += solve.limit_point
            self.last = solve
            yield solve


def reach(problem: Problem, steps: Steps, *, load: float = 0.0, passed: int = 0) -> Iterator[Solve]:
    """Yield every solve of the job's strategy and of the fallbacks, as `follow` does.

    Args:
        load: load factor at which the present state is a solution.
        passed: number of limit points between the unloaded body and the present state.
    """
    reached = _Reached(load, passed)
    yield from _strategy(problem, steps, reached)
    if isinstance(steps, FixedSteps) or reached.last is None:
        return
    for name in _rescues(problem, steps, reached.last, reached.load):
        if reached.last.outcome.accepted or reached.passed or _is_final(reached.last, reached.load):
            return
        for solve in reached.noting(_limited(RESCUES[name](problem, steps, reached.load), EFFORT[name])):
            yield replace(solve, strategy=name)


def _strategy(problem: Problem, steps: Steps, reached: _Reached) -> Iterator[Solve]:
    """Yield the solves of the job's strategy."""
    solver, series, farthest = problem.equations.job.solver, None, math.inf
    if isinstance(steps, AdaptiveSteps) and solver.continuation == "auto":
        series = _automatic_series(problem, steps)
        farthest = _farthest(problem) if series is not None else math.inf
    if isinstance(steps, AdaptiveSteps) and solver.continuation == "series":
        yield from reached.noting(_series(problem, steps, reached.load))
        last = reached.last
        if last is not None and (
            reached.load == 1.0
            or last.outcome in (Outcome.LIMIT_POINT, Outcome.INTERRUPTED)
            or last.load - reached.load < 2 * steps.least
        ):
            return
    yield from reached.noting(
        follow(
            problem.equilibrium,
            steps,
            solver.tolerance,
            load=reached.load,
            passed=reached.passed,
            stop_early="arc-length" in solver.rescue,
            series=series,
            farthest=farthest,
        )
    )


def _rescues(problem: Problem, steps: Steps, last: Solve, load: float) -> Sequence[str]:
    """Return the fallbacks to try after the last solve of the job's strategy, which reached a load."""
    names: Sequence[str] = problem.equations.job.solver.rescue
    stop_early = "arc-length" in names
    if problem.equilibrium.numbers.count:
        names = [name for name in names if name in _WITH_NUMBERS]
    others = [name for name in names if name != "arc-length"]
    if stop_early and isinstance(steps, AdaptiveSteps) and last.load - load >= 2 * steps.least:
        return ["arc-length", "load steps", *others]  # at a likely limit point
    return others if last.strategy == SERIES else names  # a series has followed the path by its length, to the end


def _farthest(problem: Problem) -> float:
    """Return the ratio of the first correction to the prediction above which `auto` takes a series."""
    if problem.equations.unknowns.size < _LARGE:
        return _FARTHEST_SMALL
    if problem.equations.chooser.is_compact:
        return _FARTHEST_COMPACT
    return _FARTHEST if problem.equilibrium.linear.choice.precision == "double" else _FARTHEST_SMALL


def _automatic_series(problem: Problem, steps: AdaptiveSteps) -> SeriesSolver | None:
    """Return the continuation by power series after a solve that failed, if factors solve the equations."""
    if problem.equilibrium.linear.configuration.name != "direct":
        return None  # each order would take a solve by multigrid to 1e-10
    if problem.equilibrium.numbers.count:
        return None  # a series has no orders of them

    def series(load: float, failed: Solve) -> Iterator[Solve]:
        return _series(problem, steps, load, failed)

    return series


def _series(problem: Problem, steps: AdaptiveSteps, load: float, failed: Solve | None = None) -> Solves:
    """Solves along the path as a power series; what it does not reach is left to load steps, with a line of the log.

    Args:
        failed: solve after which `auto` takes the series; if it was not tried, its factors are used, and counted.
    """
    solver = problem.equations.job.solver
    try:
        path = SeriesContinuation(problem.equilibrium, _SIDES[solver.branch])
    except NotAnalytic as reason:
        if failed is None:
            problem.observer.failing([f"load steps instead of a power series: {reason}"])
        return
    is_refused = failed is not None and failed.outcome is Outcome.TOO_NONLINEAR
    spent = failed.factorizations if failed is not None and is_refused else 0
    last = None
    for last in path.follow(steps, solver.tolerance, load, spent=spent, are_near=is_refused):
        yield last
    if last is not None and not (last.outcome.accepted or last.outcome in (Outcome.LIMIT_POINT, Outcome.INTERRUPTED)):
        problem.observer.failing([f"load steps instead of a power series: {last.outcome.text}"])


def _is_final(solve: Solve, load: float) -> bool:
    """Return whether no fallback can help after a failed solve."""
    if solve.outcome is Outcome.VOLUME_CHANGED:
        return load > 0
    if solve.outcome is Outcome.LINEAR_SOLVER:
        return load == 0
    if solve.outcome is Outcome.NOT_FINITE:  # the load exceeds the range of numbers
        return load == 0 and not solve.factorizations
    return solve.outcome.is_final or solve.outcome in (Outcome.LIMIT_POINT, Outcome.PASSED_THROUGH)


def _arc_length(problem: Problem, steps: Steps, load: float) -> Solves:
    if isinstance(steps, AdaptiveSteps):
        first, least = min(4 * steps.smallest, 1.0), steps.smallest / 256
        arcs = ArcLengthSteps(first, least, most=100, cases=steps.cases)
        yield from follow(problem.equilibrium, arcs, problem.equations.job.solver.tolerance, load=load)


def _load_steps(problem: Problem, steps: Steps, load: float) -> Solves:
    """Load steps of the job, beginning with a small one."""
    if isinstance(steps, AdaptiveSteps):
        small = replace(steps, first=min(16 * steps.smallest, 1.0))
        yield from follow(problem.equilibrium, small, problem.equations.job.solver.tolerance, load=load)


def _line_search(problem: Problem, steps: Steps, load: float) -> Solves:
    solver = problem.equations.job.solver
    chosen = "basic" if solver.petsc.get("snes_linesearch_type") == "l2" else "l2"
    first, least = min(16 * solver.minimum_step, 1.0), solver.minimum_step / 16
    with problem.equilibrium.newton(chosen):
        cut = AdaptiveSteps(first, least, cases=steps.cases)
        yield from follow(problem.equilibrium, cut, solver.tolerance, load=load)


def _bulk_modulus(problem: Problem, steps: Steps, load: float) -> Solves:
    rescue = BulkModulus(problem.equations, problem.equilibrium)
    if rescue.is_applicable and not problem.equilibrium.system.is_on_path:
        yield from _as_one_solve(problem, rescue.solves(), EFFORT["bulk-modulus"])


def _anderson(problem: Problem, steps: Steps, load: float) -> Solves:
    if problem.direction == "inverse":
        yield from _as_one_solve(problem, _fixed_point(problem), EFFORT["anderson"])


def _fixed_point(problem: Problem) -> Solves:
    """Solves of the fixed-point method to a coarse tolerance, and a last one of the inverse problem from there."""
    job = problem.equations.job
    coarse_settings = job.fixed_point.model_copy(update={"tolerance": 1e-3, "maximum_iterations": 20})
    problem.equations.unload()
    method = FixedPointMethod(problem.equations, problem.observer, "anderson", coarse_settings)
    try:
        for solve in method.solves():
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
    """Yield solves until they have taken too many factorizations."""
    spent = 0
    with closing(solves):
        for solve in solves:
            yield solve
            spent += solve.factorizations
            if spent > effort and not (solve.outcome.accepted and solve.load == 1.0):
                yield Solve(solve.load, Outcome.STEP_LIMIT, (), 0)
                return


def _as_one_solve(problem: Problem, solves: Solves, effort: int) -> Solves:
    """Report solves as one, since no state but the last is a solution of the problem."""
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
    """

    strategy: str
    load: float | None
    outcome: Outcome
    solves: int
    iterations: int
    factorizations: int


def attempts(solves: Sequence[Solve]) -> list[Attempt]:
    """Return the strategies tried in one direction, in order; only the last can have reached the full load."""
    attempts_made = []
    for strategy, group in groupby(solves, key=lambda solve: solve.strategy):
        own = list(group)
        reached = [s.load for s in own if s.outcome.accepted]
        attempts_made.append(
            Attempt(
                strategy,
                reached[-1] if reached else None,
                own[-1].outcome,
                len(own),
                sum(len(s.iterations) for s in own),
                sum(s.factorizations for s in own),
            )
        )
    return attempts_made
