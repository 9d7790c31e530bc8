"""Fallbacks of the direct method: other strategies, tried in turn where the strategy of the job fails.

They are tried in the order of the job, by default

============  =========================================================================================================
arc-length    arc-length continuation from the last solution
line-search   a new tangent and PETSc's l2 line search in each of Newton's iterations, from the last solution
anderson      for inverse problems: a fixed point of forward solves, refined by Newton's method
============  =========================================================================================================

Each may take `EFFORT` factorizations. Where a limit point is likely, arc-length continuation is tried before small
steps. No fallback is tried where none can help: at a limit point of the load, where the first tangent is singular, and
where the discrete equations have a solution that no body can have.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from hpcinv.model.outcome import Outcome
from hpcinv.on_demand import on_demand
from hpcinv.physics.effects import Direction
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium_path import EquilibriumPath, Policy, PolicyOnDemand, Solves, limited
from hpcinv.solver.load_stepping import AdaptiveSteps
from hpcinv.solver.newton import SERIES, Solve

EFFORT = {"arc-length": 80, "load steps": 100, "line-search": 50, "anderson": 100}

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


@dataclass(frozen=True)
class Problem:
    """A path to follow: with its equations, its direction, and the steps of the job."""

    path: EquilibriumPath
    equations: Equations
    direction: Direction
    steps: Policy

    @property
    def smallest(self) -> float:
        """Smallest step, as a share of the whole load."""
        return self.equations.job.solver.minimum_step / self.path.cases


def reach(path: EquilibriumPath, equations: Equations, direction: Direction, steps: Policy) -> Iterator[Solve]:
    """Yield every solve of the job's strategy and of the fallbacks, as a `Policy` does."""
    problem = Problem(path, equations, direction, steps)
    yield from _strategy(problem)
    if equations.job.solver.strategy == "fixed" or path.last is None:
        return
    for name in _rescues(problem, path.last):
        if path.last.outcome.accepted or path.passed or _is_final(path.last, path.load):
            return
        for solve in RESCUES[name](problem, EFFORT[name]):
            yield replace(solve, strategy=name)


def _strategy(problem: Problem) -> Iterator[Solve]:
    """Yield the solves of the job's strategy."""
    path, steps, solver = problem.path, problem.steps, problem.equations.job.solver
    if isinstance(steps, AdaptiveSteps):
        settings = (steps.smallest, steps.path_tolerance, _SIDES[solver.branch], solver.continuation == "series")
        series = PolicyOnDemand("power series", settings)
        steps = replace(steps, stop_early="arc-length" in solver.rescue)
        if solver.continuation == "series":
            yield from path.follow(series)
            last = path.last
            if last is not None and (
                path.load == 1.0
                or last.outcome in (Outcome.LIMIT_POINT, Outcome.INTERRUPTED)
                or last.load - path.load < 2 * problem.smallest
            ):
                return
        elif solver.continuation == "auto" and _may_take_series(path):
            steps = replace(steps, series=series, most_nonlinear=_most_nonlinear(problem))
    yield from path.follow(steps)


def _rescues(problem: Problem, last: Solve) -> Sequence[str]:
    """Return the fallbacks to try after the last solve of the job's strategy."""
    names: Sequence[str] = problem.equations.job.solver.rescue
    if problem.path.equilibrium.system.weak_form.contacts.depends_on_path:
        names = [name for name in names if name != "arc-length"]  # which may return to smaller loads
    stop_early = "arc-length" in names
    if problem.path.equilibrium.numbers.count:
        names = [name for name in names if name in _WITH_NUMBERS]
    others = [name for name in names if name != "arc-length"]
    is_adaptive = isinstance(problem.steps, AdaptiveSteps)
    if stop_early and is_adaptive and last.load - problem.path.load >= 2 * problem.smallest:
        return ["arc-length", "load steps", *others]  # at a likely limit point
    return others if last.strategy == SERIES else names  # a series has followed the path by its length, to the end


def _most_nonlinear(problem: Problem) -> float:
    """Return the ratio of the first correction to the prediction above which `auto` takes a series."""
    if problem.equations.unknowns.size < _LARGE:
        return _FARTHEST_SMALL
    if problem.equations.chooser.is_compact:
        return _FARTHEST_COMPACT
    return _FARTHEST if problem.path.equilibrium.linear.choice.precision == "double" else _FARTHEST_SMALL


def _may_take_series(path: EquilibriumPath) -> bool:
    """Return whether `auto` may take a series: with multigrid, each order would take a solve to 1e-10."""
    return path.equilibrium.linear.configuration.name == "direct" and not path.equilibrium.numbers.count


def _is_final(solve: Solve, load: float) -> bool:
    """Return whether no fallback can help after a failed solve."""
    if solve.outcome is Outcome.VOLUME_CHANGED:
        return load > 0
    if solve.outcome is Outcome.LINEAR_SOLVER:
        return load == 0
    if solve.outcome is Outcome.NOT_FINITE:  # the load exceeds the range of numbers
        return load == 0 and not solve.factorizations
    return solve.outcome.is_final or solve.outcome in (Outcome.LIMIT_POINT, Outcome.PASSED_THROUGH)


def _arc_length(problem: Problem, effort: int) -> Solves:
    least = problem.equations.job.solver.minimum_step
    if isinstance(problem.steps, AdaptiveSteps):
        arcs = on_demand("arc length")(min(4 * least, 1.0), least / 256, most=100)
        yield from problem.path.follow(arcs, effort)


def _load_steps(problem: Problem, effort: int) -> Solves:
    """Load steps of the job, beginning with a small one."""
    if isinstance(problem.steps, AdaptiveSteps):
        small = replace(problem.steps, first=min(16 * problem.steps.smallest, 1.0))
        yield from problem.path.follow(small, effort)


def _line_search(problem: Problem, effort: int) -> Solves:
    solver = problem.equations.job.solver
    chosen = "basic" if solver.petsc.get("snes_linesearch_type") == "l2" else "l2"
    with problem.path.equilibrium.newton(chosen):
        cut = AdaptiveSteps(min(16 * solver.minimum_step, 1.0), solver.minimum_step / 16)
        yield from problem.path.follow(cut, effort)


def _anderson(problem: Problem, effort: int) -> Solves:
    """The fixed point as one solve: no state but the last is a solution of the inverse problem."""
    if problem.direction != "inverse":
        return
    path = problem.path
    start, taken = path.place(), list(limited(_fixed_point(problem), effort))
    last = taken[-1]
    if not last.outcome.accepted:
        path.return_to(start)
    iterations = tuple(i for solve in taken for i in solve.iterations)
    factorizations = sum(solve.factorizations for solve in taken)
    yield path.report(Solve(1.0, last.outcome, iterations, factorizations, last.signs))


def _fixed_point(problem: Problem) -> Solves:
    """Solves of the fixed-point method to a coarse tolerance, and a last one of the inverse problem from there."""
    job = problem.equations.job
    coarse_settings = job.fixed_point.model_copy(update={"tolerance": 1e-3, "maximum_iterations": 20})
    problem.equations.unload()
    observer = problem.path.equilibrium.observer
    method = on_demand("fixed-point method")(problem.equations, observer, "anderson", coarse_settings)
    try:
        for solve in method.solves():
            yield solve
    finally:
        method.equilibrium.destroy()
    if solve.outcome.accepted:
        yield problem.path.equilibrium.solve(1.0, job.solver.tolerance)


RESCUES: Mapping[str, Callable[[Problem, int], Solves]] = {
    "arc-length": _arc_length,
    "load steps": _load_steps,
    "line-search": _line_search,
    "anderson": _anderson,
}


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
