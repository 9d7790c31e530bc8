"""The one flow of solves: the steps of a plan in order, each on the body and from the state that earlier ones found."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

from dolfinx.fem import Function

from hpcinv.job.job import PlannedSolve
from hpcinv.mesh.data import as_function
from hpcinv.mesh.source import DataArray
from hpcinv.model.state import State
from hpcinv.on_demand import on_demand
from hpcinv.physics.effects import Direction
from hpcinv.results.solution import Solution, solution_of
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods import solve_direction
from hpcinv.solver.methods.method import UNLOADED, Start
from hpcinv.solver.newton import CoarseSolve
from hpcinv.solver.observer import SILENT, Observer, SolvedDirection

type _Solved = tuple[SolvedDirection, CoarseSolve | None]


class StepControl(Observer):
    """Control of the steps of a plan: where each begins, and what surrounds and checks it.

    As an observer it forwards the events of their solves.

    Args:
        solves: observer of the solves.
    """

    def __init__(self, solves: Observer = SILENT) -> None:
        self.solves = solves

    def choose_start(self, number: int, equations: Equations) -> Start:
        """Return the start of a step, which begins now; the equations are unloaded; collective."""
        return UNLOADED

    def solving(self) -> AbstractContextManager[None]:
        """Return the context of the solve of a step and its evaluation."""
        return nullcontext()

    def note(self, text: str) -> None:
        """Called with lines of text on a solve on coarser cells."""

    def check(self, earlier: Sequence[Solution], solved: SolvedDirection, step: PlannedSolve) -> None:
        """Called after the solve of a step, before its solution is evaluated; may raise an error on all ranks."""


def carry_out(
    plan: Sequence[PlannedSolve],
    equations: Sequence[Equations],
    control: StepControl,
    first_solutions: Sequence[Solution] = (),
) -> Iterator[Solution]:
    """Yield the solutions of a plan in order; collective.

    Args:
        equations: of each step; several steps may share them.
        first_solutions: of the first steps, which are yielded without a solve.
    """
    solutions: list[Solution] = []
    for number, step in enumerate(plan):
        if number < len(first_solutions):
            solutions.append(first_solutions[number])
        else:
            solutions.append(_solution(number, step, equations[number], solutions, control))
        yield solutions[-1]


def _solution(
    number: int,
    step: PlannedSolve,
    equations: Equations,
    earlier: Sequence[Solution],
    control: StepControl,
) -> Solution:
    """Solve one step, on the body and from the state that earlier ones found."""
    equations.put(_unloaded(step, equations, earlier))
    start = control.choose_start(number, equations)
    if step.start is not None:
        start = replace(start, origin=earlier[step.start].fields)
    start_shape = step.job.solver.start_shape if number == 0 else None
    if start_shape is not None:
        start = replace(start, origin=_fields_at(step.job.resolve(start_shape), equations, step.direction))
    with control.solving():
        solved, coarse = _solve(number, step, equations, start, control)
        control.check(earlier, solved, step)
        weak_form = equations.weak_form(step.direction)
        solution = solution_of(equations, step.direction, weak_form, solved.solves, solved.load, solved.linear)
    start_state = start_shape or "" if step.start is None else earlier[step.start].state
    job = solution.job
    for report in solved.constraints:
        job = report.given_in(job)
    return replace(solution, job=job, constraints=solved.constraints, start=start_state, coarse=coarse)


def _unloaded(step: PlannedSolve, equations: Equations, earlier: Sequence[Solution]) -> State:
    """Return the unloaded state of a step, on the body that an earlier one found if the step names it."""
    if step.mesh is None:
        return equations.unloaded(step.job)
    body = earlier[step.mesh]
    if step.job.state:  # other loads
        return equations.unloaded(step.job, body.other_nodes, body.displacement)
    return equations.unloaded(step.job, body.other_nodes, contacts=body.contacts)


def _fields_at(path: Path, equations: Equations, direction: Direction) -> tuple[Function, Function | None]:
    """Return displacement (m) and pressure (zero) of the computed body in the shape of a mesh file; collective."""
    body, (u, p) = equations.body, equations.unloaded().fields
    nodes = on_demand("start shape")(equations.job.mesh, path, body)
    sign = equations.weak_form(direction).kinematics.sign
    u.interpolate(as_function(body, DataArray("start_shape", "nodes", sign * (nodes - body.given_nodes))))
    u.x.scatter_forward()
    return u, p


def _solve(number: int, step: PlannedSolve, equations: Equations, start: Start, control: StepControl) -> _Solved:
    """Solve a step from its start; the first one from the solution on coarser cells where that saves time."""
    if step.direction == "inverse" and any(i.assumed and i.assumed.searched_from for i in step.job.interfaces):
        searched: _Solved = on_demand("contact of least energy")(step, equations, control)
        return searched
    if number == 0 and start.is_unloaded and _may_begin_coarser(equations, step.direction):
        solved: _Solved = on_demand("nested iteration")(equations, step.direction, control.solves, control.note)
        return solved
    return solve_direction(equations, step.direction, start, control.solves), None


def _may_begin_coarser(equations: Equations, direction: Direction) -> bool:
    """Return whether the job asks for a solve on coarser cells, or one may save time; collective."""
    job = equations.job
    if job.solver.nested_iteration == "off" or job.unsuited_to_nested_iteration:
        return False
    is_asked = job.solver.nested_iteration == "on"
    return is_asked or equations.chooser.is_nested_iteration_worth(job.solver, direction)
