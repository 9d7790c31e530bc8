"""Arc-length continuation along the path of equilibria from the unloaded body, through limit points of the load."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass, replace

from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import dot, norm
from hpcinv.model.outcome import Outcome
from hpcinv.solver.bordering import BorderedTangent, Bordering, Corrected, tangent_along
from hpcinv.solver.equilibrium import Kept
from hpcinv.solver.equilibrium_path import EquilibriumPath, Policy, Solves
from hpcinv.solver.limit_point_search import PathSample, locate
from hpcinv.solver.newton import NewtonMonitor, Solve

type Moves = Generator[Solve, None, _Point | None]


@dataclass(frozen=True)
class ArcLengthSteps(Policy):
    """Steps along the path through limit points, halved where they fail and doubled where few iterations suffice.

    Args:
        first: first step, as a share of the load along the first tangent.
        smallest: shortest step, relative to the state; the path ends where it fails.
        limit_points: number of limit points to pass before a state at full load is accepted.
        path_tolerance: relative error of intermediate points; near a limit of the load it matters.
        easy: number of iterations up to which the next step is twice as long.
    """

    first: float = 1.0
    smallest: float = 1e-3
    limit_points: int = 0
    most: int = 200
    path_tolerance: float = 1e-8
    easy: int = 6

    def in_second_direction(self) -> ArcLengthSteps:
        return replace(self, limit_points=0)  # that has none

    def solves(self, path: EquilibriumPath) -> Solves:
        """Yield every solve along the path, up to one limit point more than allowed (`Outcome.LIMIT_POINT`).

        There is none if the present state is the one at full load that the steps lead to, as in a checkpoint of it.
        """
        path.begin()
        if path.load == 1.0 and path.passed >= self.limit_points:
            return
        tracing = _Tracing(path, self)
        try:
            yield from tracing.solves()
        finally:
            tracing.bordering.destroy()


@dataclass(frozen=True)
class _Point:
    x: PETSc.Vec
    load: float
    tangent: BorderedTangent
    sign: int  # of the determinant of K, 0 if not known
    place: Kept

    def ahead(self, s: float) -> PETSc.Vec:
        """Return the predicted state at a distance along the tangent."""
        x = self.x.copy()
        x.axpy(s, self.tangent.direction)
        return x


class _Tracing:
    def __init__(self, path: EquilibriumPath, steps: ArcLengthSteps) -> None:
        self.path, self.steps, self.equilibrium = path, steps, path.equilibrium
        self.bordering = Bordering(self.equilibrium, path.cases)
        self.last_point: _Point | None = None  # the last point but one since the last limit point
        self.ended, self.easy = False, False

    @property
    def direction(self) -> int:
        """1 where the load grows along the path, -1 where it falls."""
        return -1 if self.path.passed % 2 else 1

    def end_ahead(self) -> float | None:
        """Return the next load at which a step must end, ``None`` if there is none in the present direction.

        Full load is not such an end until all limit points are passed.
        """
        load, cases = self.path.load, self.path.cases
        inner = [case / cases for case in range(1, cases)]
        ends = [*inner, 1.0] if self.path.passed == self.steps.limit_points else inner
        ahead = [end for end in ends if (end - load) * self.direction > 1e-9]
        return min(ahead, key=lambda end: abs(end - load), default=None)

    def solves(self) -> Solves:
        point = self._start(self.path.load)
        if point is None:
            yield self._end(self.path.load, self.equilibrium.linear.failure)
            return
        whole = 1 / abs(point.tangent.slope)
        step = self.steps.first / self.path.cases * whole
        for _ in range(self.steps.most):
            if step < self.steps.smallest * min(whole, norm(point.x) or whole):
                return
            end = self.end_ahead()
            slope = point.tangent.slope
            end_distance = (end - point.load) / slope if end is not None and slope * self.direction > 0 else math.inf
            if end is not None and end_distance <= step * (1 + 1e-9):
                step = end_distance
                next_point = yield from self._land(point, end, point.ahead(step), step)
            else:
                next_point = yield from self._advance(point, end, step)
            if self.ended or (next_point is None and step == 0.0):
                return
            if next_point is not None:
                point, step = next_point, 2 * step if self.easy else step
            else:
                step /= 2
        yield self._end(point.load, Outcome.STEP_LIMIT)

    def _start(self, load: float) -> _Point | None:
        """Return the present state as a point of the path, with the load in its present direction."""
        x = self.equilibrium.system.position()
        tangent = self.bordering.tangent(x, load, None, self.direction)
        self.path.spent += 1
        if tangent is None:
            return None
        self.last_point = None
        sign = self.equilibrium.linear.sign_of_determinant()
        return _Point(x, load, tangent, sign, self.path.place())

    def _land(self, point: _Point, end: float, predicted: PETSc.Vec, step: float) -> Moves:
        """Solve at a fixed load from a predicted state; a distant solution may belong to another path."""
        equilibrium = self.equilibrium
        equilibrium.system.set_state(predicted)
        if equilibrium.system.fault() is not None:
            equilibrium.system.set_state(point.x)
        solve = self.path.solve(end, self.steps.path_tolerance)
        if solve.outcome.accepted:
            predicted.axpy(-1.0, equilibrium.system.position())
            crossed = bool(solve.signs and point.sign and solve.signs[-1] != point.sign)
            distance = norm(predicted)
            if crossed or (distance > step and not equilibrium.floor().exceeds(distance, NewtonMonitor.round_off)):
                solve = replace(solve, outcome=Outcome.ANOTHER_PATH)
        if not solve.outcome.accepted:
            self.path.return_to(point.place)
        yield self._report(solve)
        self.ended = solve.outcome.is_final or (solve.outcome.accepted and end == 1.0)
        self.easy = False
        return self._start(end) if solve.outcome.accepted and not self.ended else None

    def _advance(self, point: _Point, end: float | None, step: float) -> Moves:
        predicted, t = point.ahead(step), point.tangent
        load = point.load + step * t.slope
        corrected = self._corrected(predicted, load, t.direction, max(abs(point.load), abs(load)))
        predicted.axpy(-1.0, corrected.x)
        solve = corrected.solve
        if solve.outcome.accepted and norm(predicted) > step:
            solve = replace(solve, outcome=Outcome.ANOTHER_PATH)
        if corrected.g is None or not solve.outcome.accepted:
            self.path.return_to(point.place)
            yield self._report(solve)
            self.ended = solve.outcome.is_final
            return None
        if (solve.load - point.load) * self.direction < 0:
            falling_tangent = self._slope_beyond(point, corrected)
            if falling_tangent is not None or t.slope * self.direction < 0:
                return (yield from self._pass_limit_point(point, corrected, falling_tangent))
        if end is not None and (solve.load - end) * self.direction > 0:
            self.path.spent += solve.factorizations
            share = (end - point.load) / (solve.load - point.load)
            crossing = point.x.copy()
            crossing.axpby(share, 1 - share, corrected.x)
            return (yield from self._land(point, end, crossing, step))
        chord = corrected.x.copy()
        chord.axpy(-1.0, point.x)
        self.easy = len(solve.iterations) <= self.steps.easy
        self.last_point = point
        sign = solve.signs[-1] if solve.signs else point.sign
        self._move_to(corrected.x, solve.load)
        yield self._report(solve)
        return _Point(corrected.x, solve.load, tangent_along(corrected.g, chord), sign, self.path.place())

    def _move_to(self, x: PETSc.Vec, load: float) -> None:
        self.equilibrium.numbers.put(load)
        self.equilibrium.system.set_state(x)
        self.equilibrium.depart(load)

    def _corrected(self, x: PETSc.Vec, load: float, t: PETSc.Vec, scale: float) -> Corrected:
        """Return a point of the path from a predicted state, or the fault of that state."""
        self.equilibrium.system.set_state(x)
        if (fault := self.equilibrium.system.fault()) is not None:
            return Corrected(Solve(load, fault, (), 0), x)
        tolerance = self.steps.path_tolerance
        return self.bordering.correct(x, load, t, tolerance, direction=self.direction, scale=scale)

    def _slope_beyond(self, point: _Point, corrected: Corrected) -> BorderedTangent | None:
        """Return the tangent at a point with less load than the one before, if the load falls along it.

        A load that approaches a limit asymptotically may seem to fall, by the error of the points.
        """
        self.path.spent += 1
        tangent = self.bordering.tangent(corrected.x, corrected.solve.load, point.tangent.direction)
        return tangent if tangent is not None and tangent.slope * self.direction < 0 else None

    def _pass_limit_point(self, point: _Point, corrected: Corrected, falling_tangent: BorderedTangent | None) -> Moves:
        """Find the limit point before a point, and continue from there if more limit points may be passed."""
        self.path.return_to(point.place)
        fresh = self.bordering.tangent(point.x, point.load, point.tangent.direction)
        self.path.spent += 1 + corrected.solve.factorizations
        self.easy = False
        if fresh is None:
            return None
        if fresh.slope * self.direction > 0:
            if falling_tangent is None:  # two limit points, or none
                yield self._end(corrected.solve.load, Outcome.ANOTHER_PATH)
                return None
            t, sign = fresh.direction, point.sign
            low = PathSample(point.x, 0.0, point.load, fresh.slope)
            high = _path_sample(
                t, point, corrected.x, corrected.solve.load, falling_tangent.slope / dot(t, falling_tangent.direction)
            )
        elif self.last_point is not None:
            previous, t, sign = self.last_point, self.last_point.tangent.direction, self.last_point.sign
            low = PathSample(previous.x, 0.0, previous.load, previous.tangent.slope)
            high = _path_sample(t, previous, point.x, point.load, fresh.slope / dot(t, fresh.direction))
        else:
            return None
        extremum, tangent, spent = locate(self.bordering, t, low, high, direction=self.direction)
        solve = extremum.solve
        self.path.spent += spent - solve.factorizations
        if extremum.g is None:
            self.path.return_to(point.place)
            yield self._report(solve)
            self.ended = solve.outcome.is_final
            return None
        self._move_to(extremum.x, solve.load)
        yield self._report(replace(solve, limit_point=True))
        if self.path.passed > self.steps.limit_points:
            yield self._end(solve.load, Outcome.LIMIT_POINT)
            self.ended = True
            return None
        self.last_point = None
        tangent = tangent or tangent_along(extremum.g, t)
        onward = BorderedTangent(tangent.direction, self.direction * abs(tangent.slope))
        return _Point(
            extremum.x, solve.load, onward, -sign, self.path.place()
        )  # one eigenvalue of K has changed its sign

    def _end(self, load: float, outcome: Outcome) -> Solve:
        return self._report(Solve(load, outcome, (), 0))

    def _report(self, solve: Solve) -> Solve:
        return self.path.report(solve, "arc-length")


def _path_sample(t: PETSc.Vec, origin: _Point, x: PETSc.Vec, load: float, slope: float) -> PathSample:
    step = x.copy()
    step.axpy(-1.0, origin.x)
    return PathSample(x, dot(t, step), load, slope)
