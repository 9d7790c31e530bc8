"""Continuation in the load factor, from the unloaded body to the full load, in few factorizations."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from hpcinv.model.outcome import Outcome
from hpcinv.solver.arc_length import ArcLengthSteps, trace
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.newton import Solve
from hpcinv.solver.predictor import Increment


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
    state, forward = equilibrium.system.state.x, equilibrium.system.weak_form.kinematics.direction == "forward"
    step, has_tangent, ahead = steps.start(), False, LimitPointAhead()
    if load == 0.0 and not equilibrium.system.is_on_path:
        ahead.sign = equilibrium.system.weak_form.unknowns.unloaded_sign
    predict = equilibrium.predictor.predict
    spent = 0  # factorizations that are not part of a report yet
    end: _EndOfSeries | None = None
    while load < 1.0:
        target = target_of(load, step, steps.cases)
        if end is not None and end.tries > end.most:
            load, state.array[:], step, has_tangent, ahead.sign = end.load, end.values, end.step, False, end.sign
            equilibrium.depart(load)
            yield from end.reports(spent)
            if step < steps.least:
                return
            end, spent = None, 0
            continue
        accepted = state.array.copy()
        predicted = None
        if has_tangent or isinstance(steps, AdaptiveSteps):
            predicted = predict(target, new_tangent=not has_tangent)
            if has_tangent:
                ahead.rates.append(predicted.length / (target - load))
            if isinstance(steps, AdaptiveSteps):
                shorter = steps.shortened(target - load, predicted.increment, forward=forward)
                if shorter < target - load:
                    state.array[:] = accepted
                    target = target_of(load, shorter, steps.cases)
                    predicted = predict(target).including(predicted)
                if end is not None and target <= end.load:
                    end.tries += 1
                    if end.tries > end.most:
                        state.array[:], spent = accepted, predicted.factorizations
                        continue
        wanted = tolerance if target == 1.0 else steps.path_tolerance
        tangents = equilibrium.system.tangents
        solve = equilibrium.solve(target, wanted, predicted=predicted, farthest=farthest)
        solve, spent = replace(solve, factorizations=solve.factorizations + spent), 0
        if solve.outcome.accepted and isinstance(steps, AdaptiveSteps) and predicted is not None:
            moved = state.petsc_vec.array - accepted[: state.petsc_vec.local_size]
            length = math.sqrt(equilibrium.system.comm.allreduce(float(moved @ moved)))
            solve = replace(solve, may_have_jumped=length > ahead.farther * predicted.length > 0)
            if ahead.has_jumped(solve) or (solve.may_have_jumped and series is not None):
                solve = replace(solve, outcome=Outcome.ANOTHER_PATH)
        is_refused = solve.outcome is Outcome.TOO_NONLINEAR
        step = target - load if is_refused else steps.next_step(solve, target - load)
        if solve.outcome.accepted:
            # A step that changes nothing, as while an obstacle is still away, needs no tangent.
            load, has_tangent = target, has_tangent or predicted is not None or equilibrium.system.tangents > tangents
        else:
            state.array[:] = accepted
            if solve.outcome not in (Outcome.PASSED_THROUGH, Outcome.TOO_NONLINEAR):  # which say nothing about the load
                ahead.failures.append((load, target))
            has_tangent = is_refused  # the present factors belong to a state of the failed solve
        if not is_refused:
            yield solve
        if series is not None and not (solve.outcome.accepted or solve.outcome.is_final):
            last, begun, sign = None, load, ahead.sign
            for last in series(load, solve):
                if last.outcome.accepted:
                    load, sign = last.load, (last.signs or (sign,))[-1]
                yield last
            if last is not None and (load == 1.0 or last.outcome in (Outcome.LIMIT_POINT, Outcome.INTERRUPTED)):
                return
            if last is not None and load > begun:
                end = _EndOfSeries(last, load, state.array.copy(), sign)
            series, farthest, load, state.array[:] = None, math.inf, begun, accepted
            if is_refused:  # the step is tried all the same
                has_tangent = last is None
                spent = solve.factorizations if has_tangent else 0
                continue
        if not solve.outcome.accepted and (
            step < steps.least or solve.outcome.is_final or (stop_early and ahead.is_likely(load))
        ):
            if end is None or load > end.load or solve.outcome.is_final:
                return
            end.tries = end.most + 1


@dataclass
class _EndOfSeries:
    """End of a power series before the full load.

    Attributes:
        last: its last solve, which failed.
        load, values, sign: of its state, and of the tangent's determinant there.
        tries: number of steps from its beginning that end before. Beyond `most`, steps go on from the end.
    """

    last: Solve
    load: float
    values: npt.NDArray[np.float64]
    sign: int
    tries: int = 0

    most = 1  # with more of them, steps repeat the series instead of stepping over its end

    @property
    def step(self) -> float:
        return (self.last.load - self.load) / 2

    def reports(self, spent: int) -> Iterator[Solve]:
        """Yield the state at the end as a solution again, and the last solve, which took ``spent`` factorizations."""
        yield Solve(self.load, Outcome.CONVERGED, (), 0, strategy=self.last.strategy)
        yield replace(self.last, iterations=(), factorizations=spent, signs=())


def target_of(load: float, step: float, cases: int) -> float:
    """Return the load after a step, at most the end of the present load case."""
    end = min((math.floor(load * cases + 1e-9) + 1) / cases, 1.0)
    # A remainder of rounding errors is not a separate step.
    return end if load + step > end - 1e-9 / cases else load + step
