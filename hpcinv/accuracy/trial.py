"""Solution, quantities of interest and estimated errors of a job's first direction with one discretisation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hpcinv.accuracy.transfer import begin_with
from hpcinv.certificate.estimate import Estimate, estimate
from hpcinv.methods import method_for
from hpcinv.model.outcome import Outcome
from hpcinv.results.quantities_of_interest import Value, check_points, evaluate
from hpcinv.results.solution import solution_of
from hpcinv.solver.problem import Model

if TYPE_CHECKING:
    from hpcinv.accuracy.meshes import Variant
    from hpcinv.job.job import Job
    from hpcinv.mesh import Body
    from hpcinv.methods import Method
    from hpcinv.parallel.timings import Timings
    from hpcinv.results.solution import Solution
    from hpcinv.solver.newton import Solve
    from hpcinv.solver.observer import Observer


@dataclass(frozen=True)
class Spent:
    """Seconds on this rank, by what they were spent on."""

    assembly: float
    factorization: float
    compilation: float


@dataclass(frozen=True)
class Trial:
    """What came of it.

    Attributes:
        job: with the degrees and the mesh parameters of this discretisation.
        variant, body, model: its mesh and its equations.
        solution: with all solves that led to it, those of earlier trials too.
        solves: those of this one.
        quantities, estimate: values of the job's quantities of interest, and their errors; none below the full load.
        solve, estimation: what they took.
        unused_options: PETSc options of the job that nothing asked for.
    """

    job: Job
    variant: Variant
    body: Body
    model: Model
    solution: Solution
    solves: tuple[Solve, ...]
    quantities: Mapping[str, Value]
    estimate: Estimate | None
    solve: Spent
    estimation: Spent
    unused_options: list[str]

    @property
    def degree(self) -> int:
        return self.job.discretisation.displacement

    @property
    def factorizations(self) -> int:
        """Of the solves of this trial."""
        return sum(s.factorizations for s in self.solves)

    @property
    def outcome(self) -> Outcome:
        return self.solves[-1].outcome


def attempt(
    job: Job,
    variant: Variant,
    body: Body,
    timings: Timings,
    observer: Observer,
    before: Trial | None,
) -> Trial:
    """Solve and estimate one discretisation, from the solution of the one ``before``; collective."""
    with _measured(timings) as solved:
        check_points(job.quantities, body)
        model = Model(job, body, timings)
        method = method_for(model, job.directions[0], observer)
        if before is not None:
            with timings("transfer"):
                begin_with(model, before.solution, before.body)
        solves = tuple(_solve(model, method, near=before is not None))
        unused = method.equilibrium.linear.options.unused()
        method.equilibrium.destroy()
        scene = model.scene(job.directions[0])
        path = (*_path(before, model), *solves)
        solution = solution_of(model, job.directions[0], scene, path, method.reached, method.equilibrium.linear.used)
    reached = method.reached == 1.0
    quantities: Mapping[str, Value] = evaluate(job.quantities, body, solution, model) if reached else {}
    with _measured(timings) as estimated:
        found = estimate(model, solution, quantities) if reached else None
    return Trial(job, variant, body, model, solution, solves, quantities, found, solved[0], estimated[0], unused)


def _path(before: Trial | None, model: Model) -> Iterator[Solve]:
    """What was solved on the way to a state, with the signs of tangents as they are with the unknowns of ``model``.

    Each pressure is a negative eigenvalue of a stable state: with an odd number more, the sign is the opposite.
    """
    if before is not None:
        odd = (model.unknowns.pressure_size - before.model.unknowns.pressure_size) % 2
        for solve in before.solution.solves:
            yield replace(solve, signs=tuple(-sign if odd else sign for sign in solve.signs))


def _solve(model: Model, method: Method, *, near: bool) -> Iterator[Solve]:
    """At the full load from the present state if that is near to the solution, else from no load."""
    if near:
        solve = method.equilibrium.solve(1.0, model.job.solver.tolerance)
        yield solve
        if solve.outcome.accepted:
            method.reached = 1.0
        if solve.outcome.accepted or solve.outcome is Outcome.INTERRUPTED:
            return
    model.unknowns.state.x.array[:] = 0.0
    yield from method.solves()


@contextmanager
def _measured(timings: Timings) -> Iterator[list[Spent]]:
    """One entry in the list when it ends."""
    spent: list[Spent] = []
    before = dict(timings.seconds)
    yield spent

    def since(phase: str) -> float:
        return timings.seconds[phase] - before.get(phase, 0.0)

    spent.append(Spent(since("tangent"), since("factorization"), since("compile")))
