"""Continuation in the load factor, from the unloaded body to the full load, in few factorizations."""

import math
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field, replace

from hpcinv.model.outcome import Outcome
from hpcinv.solver.arc_length import ArcLengthSteps, trace
from hpcinv.solver.equilibrium import Equilibrium, Kept
from hpcinv.solver.newton import Solve
from hpcinv.solver.predictor import Increment, Prediction


@dataclass(frozen=True)
class AdaptiveSteps:
    """Load steps, at first the whole load, halved where Newton's method fails and doubled where few iterations suffice.

    A step is shortened beforehand where its linear prediction has too large rotations or strains. Rotations count in
    forward problems only, where linear steps of much more than a radian fail; in inverse ones the loads do not rotate.

    All steps but the last are solved to ``path_tolerance``. Steps are shares of a load case, and none crosses its end.
    """

    first: float = 1.0
    smallest: float = 1e-3
    path_tolerance: float = 1e-6  # of the displacement; resolves the axial strain of a slender body too
    easy: int = 6  # Newton iterations up to which the next step is twice as long
    cases: int = 1

    farthest = 2.0  # largest predicted rotation (rad) or strain (norm) of a step
    share = 0.75  # of that, the prediction of a shortened step

    def start(self) -> float:
        return self.first / self.cases

    def shortened(self, step: float, predicted: Increment, *, forward: bool) -> float:
        """Return the step, shortened if its predicted increment is too large."""
        excess = max(predicted.strain, predicted.rotation if forward else 0.0) / self.farthest
        return step if not 1 < excess < math.inf else max(self.share * step / excess, self.least)

    @property
    def least(self) -> float:
        return self.smallest / self.cases

    def next_step(self, solve: Solve, step: float) -> float:
        if not solve.outcome.accepted:
            return step / 2
        return 2 * step if len(solve.iterations) <= self.easy else step


@dataclass(frozen=True)
class FixedSteps:
    """Equal steps in each load case, each solved to the final tolerance; the first failure ends the run."""

    count: int
    path_tolerance: float
    cases: int = 1

    @property
    def least(self) -> float:
        return self.start()

    def start(self) -> float:
        return 1.0 / (self.count * self.cases)

    def next_step(self, solve: Solve, step: float) -> float:
        return step if solve.outcome.accepted else 0.0


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


type Steps = AdaptiveSteps | FixedSteps | ArcLengthSteps
type SeriesSolver = Callable[[float, Solve], Iterator[Solve]]
"""Solves from a load factor on, after a solve that failed there."""


def follow(
    equilibrium: Equilibrium,
    steps: Steps,
    tolerance: float,
    *,
    load: float = 0.0,
    passed: int = 0,
    stop_early: bool = False,
    series: SeriesSolver | None = None,
    farthest: float = math.inf,
) -> Iterator[Solve]:
    """Yield every solve on the path from ``load``, where the state is in equilibrium, to the full load.

    The state is always the state of the last accepted solve. The last solve is accepted at load factor 1, or its
    outcome is the reason why the full load was not reached.

    Args:
        passed: number of limit points between the unloaded body and the present state.
        stop_early: stop where a limit point is likely, before the smallest step is reached.
        series: continues adaptive steps where one fails, or is expected to. If that ends early, long steps from where
            it began may step over the states at which it ends; other steps follow from there.
        farthest: ratio of the first correction of a step to its prediction, above which that is expected.
    """
    equilibrium.system.begin_unloaded()
    equilibrium.depart(load)
    if isinstance(steps, ArcLengthSteps):
        yield from trace(equilibrium, steps, tolerance, load=load, passed=passed)
        return
    path = _LoadSteps(equilibrium, steps, tolerance, load, series, farthest)
    yield from path.solves(stop_early=stop_early)


@dataclass
class _EndOfSeries:
    """End of a power series before the full load.

    Attributes:
        last: its last solve, which failed.
        load, kept, sign: of its state, the state, and the sign of the tangent's determinant there.
        tries: number of steps from its beginning that end before. Beyond `most`, steps go on from the end.
    """

    last: Solve
    load: float
    kept: Kept
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

    @property
    def step(self) -> float:
        return (self.last.load - self.load) / 2

    def reports(self, spent: int) -> Iterator[Solve]:
        """Yield the state at the end as a solution again, and the last solve, which took ``spent`` factorizations."""
        yield Solve(self.load, Outcome.CONVERGED, (), 0, strategy=self.last.strategy)
        yield replace(self.last, iterations=(), factorizations=spent, signs=())


class _LoadSteps:
    """Adaptive or fixed steps from a load factor on. Arguments are the arguments of `follow`; methods are collective.

    Attributes:
        _step: the next step.
        _has_tangent: whether the factors predict it.
        _spent: factorizations that are not part of a report yet.
        _end: end of the series from which steps may go on.
    """

    def __init__(
        self,
        equilibrium: Equilibrium,
        steps: AdaptiveSteps | FixedSteps,
        tolerance: float,
        load: float,
        series: SeriesSolver | None,
        farthest: float,
    ) -> None:
        self._equilibrium, self._steps, self._tolerance, self._load = equilibrium, steps, tolerance, load
        self._series, self._farthest = series, farthest
        self._step, self._has_tangent, self._spent = steps.start(), False, 0
        self._ahead = LimitPointAhead()
        self._end: _EndOfSeries | None = None
        if load == 0.0 and not equilibrium.system.is_on_path and not equilibrium.numbers.count:
            self._ahead.sign = equilibrium.system.weak_form.unknowns.unloaded_sign

    def solves(self, *, stop_early: bool) -> Iterator[Solve]:
        """Yield the solves to the full load, or to the failed one at which the path ends."""
        while self._load < 1.0:
            if self._end is not None and self._end.is_next:
                yield from self._begin_at(self._end)
                if self._step < self._steps.least:
                    return
                continue
            solve = self._attempt()
            if solve is None:
                continue
            has_failed, is_refused = not solve.outcome.accepted, solve.outcome is Outcome.TOO_NONLINEAR
            if not is_refused:
                yield solve
            if self._series is not None and has_failed and not solve.outcome.is_final:
                is_over = yield from self._follow(self._series, solve)
                if is_over:
                    return
                if is_refused:  # the step is tried all the same
                    continue
            if has_failed and self._is_at_end(solve, stop_early=stop_early):
                if self._end is None or self._load > self._end.load or solve.outcome.is_final:
                    return
                self._end.take_next()

    def _is_at_end(self, solve: Solve, *, stop_early: bool) -> bool:
        """Return whether no shorter step is tried after a failed one."""
        is_likely = stop_early and self._ahead.is_likely(self._load)
        return self._step < self._steps.least or solve.outcome.is_final or is_likely

    def _attempt(self) -> Solve | None:
        """Return the solve of the next step, or ``None`` if it would end before the end of the series once more."""
        equilibrium, accepted = self._equilibrium, self._equilibrium.kept()
        target, predicted = self._predicted(accepted)
        if self._end is not None and target <= self._end.load:
            self._end.tries += 1
            if self._end.is_next:
                equilibrium.restore(accepted)
                self._spent = predicted.factorizations if predicted is not None else 0
                return None
        wanted = self._tolerance if target == 1.0 else self._steps.path_tolerance
        tangents = equilibrium.system.tangents
        solve = equilibrium.solve(target, wanted, predicted=predicted, farthest=self._farthest)
        solve, self._spent = replace(solve, factorizations=solve.factorizations + self._spent), 0
        if solve.outcome.accepted and isinstance(self._steps, AdaptiveSteps) and predicted is not None:
            solve = self._compared(solve, accepted, predicted)
        is_refused, step = solve.outcome is Outcome.TOO_NONLINEAR, target - self._load
        self._step = step if is_refused else self._steps.next_step(solve, step)
        if solve.outcome.accepted:
            self._load = target
            # A step that changes nothing, as while an obstacle is still away, needs no tangent.
            self._has_tangent |= predicted is not None or equilibrium.system.tangents > tangents
        else:
            equilibrium.restore(accepted)
            if solve.outcome not in (Outcome.PASSED_THROUGH, Outcome.TOO_NONLINEAR):  # which say nothing about the load
                self._ahead.failures.append((self._load, target))
            self._has_tangent = is_refused  # the present factors belong to a state of the failed solve
        return solve

    def _predicted(self, accepted: Kept) -> tuple[float, Prediction | None]:
        """Move the state to the prediction of the next step, if any; return the load factor and the prediction."""
        load, steps, equilibrium = self._load, self._steps, self._equilibrium
        target, predict = target_of(load, self._step, steps.cases), equilibrium.predict
        if not (self._has_tangent or isinstance(steps, AdaptiveSteps)):
            return target, None
        predicted = predict(target, new_tangent=not self._has_tangent)
        if self._has_tangent:
            self._ahead.rates.append(predicted.length / (target - load))
        if isinstance(steps, AdaptiveSteps):
            forward = equilibrium.system.weak_form.kinematics.direction == "forward"
            shorter = steps.shortened(target - load, predicted.increment, forward=forward)
            if shorter < target - load:
                equilibrium.restore(accepted)
                target = target_of(load, shorter, steps.cases)
                predicted = predict(target).including(predicted)
        return target, predicted

    def _compared(self, solve: Solve, accepted: Kept, predicted: Prediction) -> Solve:
        """Return an accepted solve, rejected if it has left the path, by its distance and by the tangent's sign."""
        state = self._equilibrium.system.state.x.petsc_vec
        moved = state.array - accepted[0][: state.local_size]
        length = math.sqrt(self._equilibrium.system.comm.allreduce(float(moved @ moved)))
        solve = replace(solve, may_have_jumped=length > self._ahead.farther * predicted.length > 0)
        if self._ahead.has_jumped(solve) or (solve.may_have_jumped and self._series is not None):
            return replace(solve, outcome=Outcome.ANOTHER_PATH)
        return solve

    def _follow(self, series: SeriesSolver, failed: Solve) -> Generator[Solve, None, bool]:
        """Yield the solves of the series after a failed one; return whether the path ends there.

        If it does not, the state is where the series began.
        """
        last, load, sign, accepted = None, self._load, self._ahead.sign, self._equilibrium.kept()
        for last in series(load, failed):
            if last.outcome.accepted:
                load, sign = last.load, (last.signs or (sign,))[-1]
            yield last
        if last is not None and (load == 1.0 or last.outcome in (Outcome.LIMIT_POINT, Outcome.INTERRUPTED)):
            return True
        if last is not None and load > self._load:
            self._end = _EndOfSeries(last, load, self._equilibrium.kept(), sign)
        self._series, self._farthest = None, math.inf
        self._equilibrium.restore(accepted)
        if failed.outcome is Outcome.TOO_NONLINEAR:
            self._has_tangent = last is None
            self._spent = failed.factorizations if last is None else 0
        return False

    def _begin_at(self, end: _EndOfSeries) -> Iterator[Solve]:
        """Go on from the end of the series, and yield its reports."""
        self._load, self._step = end.load, end.step
        self._equilibrium.restore(end.kept)
        self._has_tangent, self._ahead.sign = False, end.sign
        self._equilibrium.depart(end.load)
        yield from end.reports(self._spent)
        self._end, self._spent = None, 0


def target_of(load: float, step: float, cases: int) -> float:
    """Return the load after a step, at most the end of the present load case."""
    end = min((math.floor(load * cases + 1e-9) + 1) / cases, 1.0)
    # A remainder of rounding errors is not a separate step.
    return end if load + step > end - 1e-9 / cases else load + step
