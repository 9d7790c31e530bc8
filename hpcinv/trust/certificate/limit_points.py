"""Limit points of the path to a solution, from the reports of its solves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods.method import NESTED
from hpcinv.solver.newton import SERIES, SWITCHED, Solve
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Verdict, skipped, topic
from hpcinv.trust.certificate.stability import StabilityCheck

LIMIT_POINTS = topic(
    "limit points of the path",
    "Whether the load rose steadily on the way, so that the solution belongs to the unloaded body.",
    "Compare with smaller steps (solver.initial_step), or with 'limit_points: 0'.",
    "Compare with smaller steps, or with a path without 'start' or 'start_shape'.",
    computed="sign of the tangent's determinant along the path; not decided if two changes may be in one step",
    thresholds="any; never",
)
_RULE = "the determinant of the tangent must keep its sign from the unloaded body to the loaded one"
_OTHER = "another shape may carry the same load"


class LimitPointCheck(Check):
    """Look for limit points of the path."""

    name, order = "limit points", 140

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        run.free()  # this check may need the memory
        if run.solution.remote_loads:
            yield skipped(LIMIT_POINTS, "with remote loads they are not looked for")
        elif run.solution.cavities:
            yield skipped(LIMIT_POINTS, "the pressure is unknown, and its limit points do not end the path")
        elif run.solution.constraints:
            yield skipped(LIMIT_POINTS, f"{run.solution.constraints[0].what} is unknown, and they are not looked for")
        else:
            yield from limit_points(run.equations, run.solution, *run.lines[StabilityCheck])


def limit_points(equations: Equations, solution: Solution, stability: Line) -> Iterator[Line]:
    """Yield the line on limit points of the path to a solution.

    A spurious mode changes the sign of the determinant too: where the line on ``stability`` did not exclude that, a
    change of sign in the mixed form is not decided. Nor is one on a path from another state, along which the nodal
    forces that hold the body there are taken away: no load of the job is such forces. Nor is one from a rough shape
    to its end, or from the given body to that.
    """
    if solution.start and solution.start == solution.job.solver.start_shape:
        yield _start_shape_line(solution, equations.unknowns.unloaded_sign)
        return
    is_stability_known = stability.verdict not in (Verdict.UNDECIDED, Verdict.SKIPPED)
    may_be_spurious = equations.unknowns.p is not None and not is_stability_known
    line = _known_line(solution) or _sign_line(equations, solution, may_be_spurious=may_be_spurious)
    yield _removal_line(line, solution.start) if solution.start else line


def _start_shape_line(solution: Solution, unloaded: int) -> Line:
    """Return the line on a path from a rough shape, which may end in one of several bodies that carry the load."""
    solves = [solve for solve in solution.solves if solve.outcome.accepted]
    signs = [solve.signs[-1] for solve in solves if solve.signs]
    began = f"the path began with the shape '{solution.start}', not with the given body"
    if (jumped := next((solve.load for solve in solves if solve.may_have_jumped), None)) is not None:
        doubt = f"its step to load factor {jumped:.4g} moved the body farther than the tangent predicts"
    elif len(set(signs)) > 1:
        doubt = "the determinant of the tangent changed its sign on the way"
    elif signs and signs[-1] != unloaded:
        doubt = "the determinant of the tangent has another sign than on the given body without loads"
    else:
        return skipped(LIMIT_POINTS, began)
    rule = "the determinant of the tangent must keep the sign that it has on the given body without loads"
    note = f"{began}; {doubt}: another body may carry the same load"
    return Line(LIMIT_POINTS, None, "", rule, Verdict.UNDECIDED, note)


def _removal_line(line: Line, start: str) -> Line:
    rule = f"the determinant of the tangent must keep its sign from state '{start}' to this one"
    if line.verdict is not Verdict.WARN:
        return replace(line, rule=rule)
    note = f"forces that held the body in state '{start}' were removed, which may end the path too"
    return replace(line, rule=rule, verdict=Verdict.UNDECIDED, note=note)


def _precise_sign(equations: Equations, solution: Solution) -> int:
    """Return the sign at the solution by factors in double precision, 0 if its solves had such factors; collective.

    Rounding errors in single precision can change the sign where rigid motions are held by soft springs.
    """
    equations.put(solution)
    equilibrium = equations.equilibrium(equations.weak_form(solution.direction))
    linear, sign = equilibrium.linear, 0
    if linear.choice.precision == "single" and not linear.configuration.exact and linear.become_exact():
        equilibrium.system.linearise(1.0)
        linear.factorize()
        sign = linear.sign_of_determinant()
    equations.release(equilibrium)
    return sign


def _known_line(solution: Solution) -> Line | None:
    """Return the line where the solves name limit points or branches, or there is no path; else ``None``."""
    if turned := sum(s.limit_point for s in solution.solves):
        return _line_of_turns(solution, turned)
    if branches := [s for s in solution.solves if s.bifurcation is not None]:
        return _line_of_branches(branches)
    if not any(s.factorizations or s.signs for s in solution.solves):
        return Line(LIMIT_POINTS, 0.0, "", _RULE, Verdict.PASS, "nothing moves the body")
    return None


def _line_of_turns(solution: Solution, turned: int) -> Line:
    """Return the line of a path past limit points."""
    note = _OTHER
    if passed := _earlier_passes([s.load for s in _accepted(solution)]):
        times = "once" if passed == 1 else f"{passed} times"
        note = f"the path passes {turned} limit point{'s'[: turned > 1]}; it reaches the full load {times} before"
    return Line(LIMIT_POINTS, float(turned), "", _RULE, Verdict.WARN, note)


def _line_of_branches(branches: Sequence[Solve]) -> Line:
    """Return the line of solves at which branches were found."""
    mode = ", ".join(f"{component:.2g}" for component in branches[0].mode)
    does = "leaves the first one" if branches[0].strategy == SWITCHED else "passes others, which branch off"
    note = f"the path {does} at load factor {branches[0].bifurcation:.6g}, with displacements along ({mode})"
    return Line(LIMIT_POINTS, float(len(branches)), "", _RULE, Verdict.WARN, note)


def _sign_line(equations: Equations, solution: Solution, *, may_be_spurious: bool) -> Line:
    """Return the line by the signs of the tangent's determinant.

    Only the last tangent of a solve counts: it has the sign at the solution, since corrections with it have contracted.
    Other tangents belong to states that Newton's method passed. The first tangent of a path belongs to the undeformed
    body under the load of its first step, which is not an equilibrium. It counts on a path from another state only.
    """
    signs = [s.signs for s in _accepted(solution) if s.signs]
    # A series whose load has a maximum is not followed beyond it.
    rises = all(s.strategy == SERIES for s in _accepted(solution))
    if not signs and rises:
        rule = "the load must rise along the path from the unloaded body to the loaded one"
        return Line(LIMIT_POINTS, 0.0, "", rule, Verdict.PASS, "the load rises all along the power series")
    if not signs:
        return skipped(LIMIT_POINTS, "an iterative solver does not provide the sign of the tangent's determinant")
    start_sign = signs[0][0] if solution.start else equations.unknowns.unloaded_sign
    if all(solve_signs[-1] == start_sign for solve_signs in signs):
        return _same_sign_line(solution, start_sign, rises=rises)
    if signs[-1][-1] != start_sign and _precise_sign(equations, solution) == start_sign:
        note = "at the full load, factors in single precision have another sign than those in double precision"
        return Line(LIMIT_POINTS, 1.0, "", _RULE, Verdict.UNDECIDED, note)
    if may_be_spurious:
        note = f"a mode that may be spurious (see the line on stability), or {_OTHER}"
        return Line(LIMIT_POINTS, 1.0, "", _RULE, Verdict.UNDECIDED, note)
    return Line(LIMIT_POINTS, 1.0, "", _RULE, Verdict.WARN, _OTHER)


def _same_sign_line(solution: Solution, sign: int, *, rises: bool) -> Line:
    """Return the line of a path with the same sign at each solution."""
    if (load := _load_of_jump(solution.solves, sign)) is not None:
        note = (
            f"the step to load factor {load:.4g} may have left the path: the body moved farther than the tangent"
            " predicts, or Newton's method passed states with another sign (continuation: series follows it)"
        )
        return Line(LIMIT_POINTS, 0.0, "", _RULE, Verdict.UNDECIDED, note)
    # A coarse solve with a limit point on its path, or another sign at the end of it, is not used.
    nested = any(s.strategy == NESTED for s in _accepted(solution))
    note = "the same sign at each load that was solved" + (", on coarser cells along the path" if nested else "")
    note += ", and the load rises all along the power series" if rises else ""
    return Line(LIMIT_POINTS, 0.0, "", _RULE, Verdict.PASS, note)


def _accepted(solution: Solution) -> list[Solve]:
    return [solve for solve in solution.solves if solve.outcome.accepted]


def _load_of_jump(solves: Sequence[Solve], sign: int) -> float | None:
    """Return the load of the first load step that may have left the path, ``None`` if there is none.

    A step that fails is halved; halves that end where the tangent has its sign again, after states where it has not,
    may end beyond a limit point. Slender bodies overshoot in other steps: those count if they move the body much
    farther than the tangent predicts.
    """
    has_failed = False
    for solve in solves:
        if not solve.outcome.accepted:
            has_failed = True
            continue
        is_shortened = has_failed and solve.strategy == "load steps"
        if solve.may_have_jumped or (is_shortened and any(passed != sign for passed in solve.signs[1:-1])):
            return solve.load
    return None


def _earlier_passes(loads: list[float]) -> int:
    """Return how often a path from the unloaded body passes the full load before it ends there."""
    path = [load - 1 for load in (0.0, *loads)]
    return sum(previous * following < 0 for previous, following in pairwise(path))
