"""Load steps from the present load to the full load, in few factorizations."""

import math
from collections.abc import Generator
from dataclasses import dataclass, field, replace

from hpcinv.model.outcome import Outcome
from hpcinv.solver.equilibrium import Kept
from hpcinv.solver.equilibrium_path import EquilibriumPath, Policy, Solves
from hpcinv.solver.newton import Solve
from hpcinv.solver.predictor import Increment, Prediction


@dataclass(frozen=True)
class LoadSteps(Policy):
    """Load steps, each a share of a load case.

    Args:
        first: the first one; smallest: the least one that is tried.
        path_tolerance: estimated error of the states on the way, relative to the displacement.
        stop_early: stop where a limit point is likely, before the smallest step is reached.
        series: goes on where a step fails, or is expected to. If it ends early, long steps from where it began may
            step over the states at which it ends; other steps follow from there.
        most_nonlinear: ratio of the first correction of a step to its prediction, above which that is expected.
    """

    first: float = 1.0
    smallest: float = 1e-3
    path_tolerance: float = 1e-6  # resolves the axial strain of a slender body too
    stop_early: bool = False
    series: Policy | None = None
    most_nonlinear: float = math.inf

    def solves(self, path: EquilibriumPath) -> Solves:
        path.begin()
        yield from _Stepping(path, self).solves()

    def next_step(self, solve: Solve, step: float) -> float:
        """Return the step after a solve; it fails where it is smaller than the smallest one."""
        return step if solve.outcome.accepted else 0.0


@dataclass(frozen=True)
class AdaptiveSteps(LoadSteps):
    """Load steps, at first the whole load, halved where Newton's method fails and doubled where few iterations suffice.

    A step is shortened beforehand where its linear prediction has too large rotations or strains. Rotations count in
    forward problems only, where linear steps of much more than a radian fail; in inverse ones the loads do not rotate.
    """

    easy: int = 6  # Newton iterations up to which the next step is twice as long

    farthest = 2.0  # largest predicted rotation (rad) or strain (norm) of a step
    share = 0.75  # of that, the prediction of a shortened step

    def shortened(self, step: float, predicted: Increment, *, forward: bool, least: float) -> float:
        """Return the step, shortened to no less than ``least`` if its predicted increment is too large."""
        excess = max(predicted.strain, predicted.rotation if forward else 0.0) / self.farthest
        return step if not 1 < excess < math.inf else max(self.share * step / excess, least)

    def next_step(self, solve: Solve, step: float) -> float:
        if not solve.outcome.accepted:
            return step / 2
        return 2 * step if len(solve.iterations) <= self.easy else step


def equal_steps(count: int, tolerance: float) -> LoadSteps:
    """Return equal steps in each load case, all solved to one tolerance; the first failure ends the path."""
    return LoadSteps(1 / count, 1 / count, tolerance)


@dataclass
class LimitPointAhead:
    """Indications of a limit point: a growing rate of change of the state, and repeated failures beyond a load.

    ``rates`` are derivatives of the state by the load at accepted solutions, ``failures`` pairs of initial and target
    load of failed solves. Failures from three solutions are required, since large steps fail for other reasons, too.
    ``sign`` is the sign of the tangent's determinant at the last solution, 0 if it is not known.
    """

    rates: list[float] = field(default_factory=list)
    failures: list[tuple[float, float]] = field(default_factory=list)
    sign: int = 0

    farther = 2.5
    """Ratio of a step to its prediction above which it may have passed limit points. It is 2 on the way to one, where
    the load is a parabola, and 3.5 to 6 where a shallow arch snaps through. Lowered, more steps are checked by series.
    """

    def has_jumped(self, solve: Solve) -> bool:
        """Return whether a step, shortened after failures farther on, has left the path; else note its sign.

        The number of negative eigenvalues has changed by an odd number there: solutions near a limit point repel
        Newton's method, and it finds one of another path. Steps that pass a bifurcation do not fail before.
        """
        if not solve.signs:
            return False
        is_same = self.sign in (0, solve.signs[-1])
        if not is_same and any(end > solve.load for _, end in self.failures):
            return True
        self.sign = solve.signs[-1]
        return False

    def is_likely(self, load: float) -> bool:
        """Return whether a limit point is likely after the last failure, of a solve that began at ``load``."""
        ceiling = self.failures[-1][1] if self.failures else 0.0
        starts = {begin for begin, end in self.failures if load < end <= ceiling}
        return len(starts) >= 3 and len(self.rates) >= 2 and self.rates[-1] > self.rates[-2]


@dataclass
class _EndOfSeries:
    """End of a power series before the full load.

    Attributes:
        last: the last solve of the series, which failed.
        load: load factor where the series ends.
        place: state where the series ends.
        sign: sign of the tangent's determinant in that state.
        tries: number of load steps that began with the series and ended before its end. After more than `most` of
            them, steps begin at the end of the series.
    """

    last: Solve
    load: float
    place: Kept
    sign: int
    tries: int = 0

    most = 1  # with more of them, steps repeat the series instead of stepping over its end

    @property
    def is_next(self) -> bool:
        """Whether steps go on from the end."""
        return self.tries > self.most

    def take_next(self) -> None:
        """Let steps go on from the end, without more tries."""
        self.tries = self.most + 1


class _Stepping:
    """Load steps along a path; methods are collective.

    Attributes:
        _step: the next step.
        _has_tangent: whether the factors predict it.
        _end: end of the series from which steps may go on.
    """

    def __init__(self, path: EquilibriumPath, steps: LoadSteps) -> None:
        self._path, self._steps, self._equilibrium = path, steps, path.equilibrium
        self._series, self._most_nonlinear = steps.series, steps.most_nonlinear
        self._step, self._least = steps.first / path.cases, steps.smallest / path.cases
        load = 0.0
        for solve in path.earlier:
            self._step = steps.next_step(solve, solve.load - load)
            load = solve.load if solve.outcome.accepted else load
        path.earlier = ()
        self._has_tangent = False
        self._ahead = LimitPointAhead()
        self._end: _EndOfSeries | None = None
        if path.load == 0.0 and not self._equilibrium.system.is_on_path and not self._equilibrium.numbers.count:
            self._ahead.sign = self._equilibrium.system.weak_form.unknowns.unloaded_sign

    def solves(self) -> Solves:
        """Yield the solves to the full load, or to the failed one at which the path ends."""
        path = self._path
        while path.load < 1.0:
            if self._end is not None and self._end.is_next:
                yield from self._begin_at(self._end)
                if self._step < self._least:
                    return
                continue
            solve = self._attempt()
            if solve is None:
                continue
            has_failed, is_refused = not solve.outcome.accepted, solve.outcome is Outcome.TOO_NONLINEAR
            if is_refused:
                path.spent += solve.factorizations
            else:
                yield path.report(solve)
            if self._series is not None and has_failed and not solve.outcome.is_final:
                is_over = yield from self._follow(self._series, are_near=is_refused)
                if is_over:
                    return
                if is_refused:  # the step is tried all the same
                    continue
            if has_failed and self._is_at_end(solve):
                if self._end is None or path.load > self._end.load or solve.outcome.is_final:
                    return
                self._end.take_next()

    def _is_at_end(self, solve: Solve) -> bool:
        """Return whether no shorter step is tried after a failed one."""
        is_likely = self._steps.stop_early and self._ahead.is_likely(self._path.load)
        return self._step < self._least or solve.outcome.is_final or is_likely

    def _attempt(self) -> Solve | None:
        """Return the solve of the next step, or ``None`` if it would end before the end of the series once more."""
        path, system, place = self._path, self._equilibrium.system, self._path.place()
        target, predicted = self._predicted(place)
        if self._end is not None and target <= self._end.load:
            self._end.tries += 1
            if self._end.is_next:
                path.return_to(place)
                path.spent += predicted.factorizations if predicted is not None else 0
                return None
        tangents = system.tangents
        solve = path.solve(target, self._steps.path_tolerance, predicted=predicted, farthest=self._most_nonlinear)
        if solve.outcome.accepted and isinstance(self._steps, AdaptiveSteps) and predicted is not None:
            solve = self._compared(solve, place, predicted)
        is_refused, step = solve.outcome is Outcome.TOO_NONLINEAR, target - path.load
        self._step = step if is_refused else self._steps.next_step(solve, step)
        if solve.outcome.accepted:
            # A step that changes nothing, as while an obstacle is still away, needs no tangent.
            self._has_tangent |= predicted is not None or system.tangents > tangents
        else:
            path.return_to(place)
            if solve.outcome not in (Outcome.PASSED_THROUGH, Outcome.TOO_NONLINEAR):  # which say nothing about the load
                self._ahead.failures.append((path.load, target))
            self._has_tangent = is_refused  # the present factors belong to a state of the failed solve
        return solve

    def _predicted(self, place: Kept) -> tuple[float, Prediction | None]:
        """Move the state to the prediction of the next step, if any; return the load factor and the prediction."""
        path, steps, predict = self._path, self._steps, self._equilibrium.predict
        target = path.target(self._step)
        if not (self._has_tangent or isinstance(steps, AdaptiveSteps)):
            return target, None
        predicted = predict(target, new_tangent=not self._has_tangent)
        if self._has_tangent:
            self._ahead.rates.append(predicted.length / (target - path.load))
        if isinstance(steps, AdaptiveSteps):
            forward = self._equilibrium.system.weak_form.kinematics.direction == "forward"
            step = target - path.load
            shorter = steps.shortened(step, predicted.increment, forward=forward, least=self._least)
            if shorter < step:
                path.return_to(place)
                target = path.target(shorter)
                predicted = predict(target).including(predicted)
        return target, predicted

    def _compared(self, solve: Solve, place: Kept, predicted: Prediction) -> Solve:
        """Return an accepted solve, rejected if it has left the path, by its distance and by the tangent's sign."""
        state = self._equilibrium.system.state.x.petsc_vec
        moved = state.array - place[0][: state.local_size]
        length = math.sqrt(self._equilibrium.system.comm.allreduce(float(moved @ moved)))
        solve = replace(solve, may_have_jumped=length > self._ahead.farther * predicted.length > 0)
        if self._ahead.has_jumped(solve) or (solve.may_have_jumped and self._series is not None):
            return replace(solve, outcome=Outcome.ANOTHER_PATH)
        return solve

    def _follow(self, series: Policy, *, are_near: bool) -> Generator[Solve, None, bool]:
        """Yield the solves of the series after a failed solve; return whether the path ends there.

        If it does not, the path is where the series began.

        Args:
            are_near: whether the present factors belong to a tangent near the present state.
        """
        path = self._path
        last, load, sign, place = None, path.load, self._ahead.sign, path.place()
        path.has_near_factors = are_near
        for last in path.follow(series):
            if last.outcome.accepted:
                sign = (last.signs or (sign,))[-1]
            yield last
        if last is not None and (path.load == 1.0 or last.outcome in (Outcome.LIMIT_POINT, Outcome.INTERRUPTED)):
            return True
        if last is not None and path.load > load:
            self._end = _EndOfSeries(last, path.load, path.place(), sign)
        self._series, self._most_nonlinear = None, math.inf
        path.load = load
        path.return_to(place)
        if are_near:
            self._has_tangent = last is None
        return False

    def _begin_at(self, end: _EndOfSeries) -> Solves:
        """Go on from the end of the series, and yield its state as a solution again, and its last solve."""
        path = self._path
        path.load, self._step = end.load, (end.last.load - end.load) / 2
        path.return_to(end.place)
        self._has_tangent, self._ahead.sign, self._end = False, end.sign, None
        spent, path.spent = path.spent, 0
        yield path.report(Solve(end.load, Outcome.CONVERGED, (), 0, strategy=end.last.strategy))
        yield path.report(replace(end.last, iterations=(), factorizations=spent, signs=()))
