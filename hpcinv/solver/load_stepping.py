"""Continuation in the load factor: from the unloaded body to the full load, in as few factorizations as it takes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hpcinv.model.outcome import Outcome
from hpcinv.solver.arc_length import ArcLengthSteps, trace

if TYPE_CHECKING:
    from hpcinv.solver.equilibrium import Equilibrium, Solve
    from hpcinv.solver.step_measure import Increment


@dataclass(frozen=True)
class AdaptiveSteps:
    """Try the whole remaining load, halve the step where Newton's method fails, and lengthen it where it is easy.

    A step is shortened beforehand where its tangent foretells that it turns or stretches the body too far: in forward
    problems linear steps of much more than a radian are no use. In inverse problems they are, as the loads do not turn.

    Steps before the last only lead the way, so they are solved to ``path_tolerance``. Steps are shares of a load case,
    and none goes beyond the end of its case.
    """

    first: float = 1.0
    smallest: float = 1e-3
    path_tolerance: float = 1e-6  # of the displacement: the stretch of a slender body must be right as well
    easy: int = 6  # Newton iterations up to which the next step is twice as long
    cases: int = 1

    farthest = 2.0  # rad, and norm of the strain, of a step as it is foretold
    share = 0.75  # of that, to which a longer one is shortened

    def start(self) -> float:
        return self.first / self.cases

    def shortened(self, step: float, foretold: Increment, *, forward: bool) -> float:
        """The part of a step that may be tried."""
        excess = max(foretold.stretch, foretold.turn if forward else 0.0) / self.farthest
        return step if not 1 < excess < math.inf else max(self.share * step / excess, self.least)

    @property
    def least(self) -> float:
        return self.smallest / self.cases

    def after(self, solve: Solve, step: float) -> float:
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

    def after(self, solve: Solve, step: float) -> float:
        return step if solve.outcome.accepted else 0.0


@dataclass
class LimitPointAhead:
    """Signs of a turning point of the load: the state changes ever faster, and Newton's method fails beyond a load.

    ``rates`` are those of the state by the load at accepted solutions, ``failures`` where solves began and should have
    ended. A load, or more than that, must have failed from three solutions: large steps fail for other reasons, too.
    """

    rates: list[float] = field(default_factory=list)
    failures: list[tuple[float, float]] = field(default_factory=list)

    def seen_from(self, load: float) -> bool:
        """Whether there are these signs after the last failure, of a solve that began at ``load``."""
        ceiling = self.failures[-1][1]
        starts = {begin for begin, end in self.failures if load < end <= ceiling}
        return len(starts) >= 3 and len(self.rates) >= 2 and self.rates[-1] > self.rates[-2]


type Steps = AdaptiveSteps | FixedSteps | ArcLengthSteps


def follow(
    equilibrium: Equilibrium,
    steps: Steps,
    tolerance: float,
    *,
    load: float = 0.0,
    turned: int = 0,
    patient: bool = True,
) -> Iterator[Solve]:
    """Yield every solve on the way from ``load``, at which the state is in equilibrium, to the full load.

    The state is always that of the last accepted solve. The last solve yielded is at load factor 1 and accepted, or
    says why the load was not reached.

    Args:
        turned: turning points of the load on the way to the present state.
        patient: go on to the smallest step also where a turning point of the load seems to lie ahead.
    """
    if isinstance(steps, ArcLengthSteps):
        yield from trace(equilibrium, steps, tolerance, load=load, passed=turned)
        return
    state, forward = equilibrium.system.state.x, equilibrium.system.scene.kinematics.direction == "forward"
    step, has_tangent, ahead = steps.start(), False, LimitPointAhead()
    predict = equilibrium.predictor.predict
    while load < 1.0:
        target = _target(load, step, steps.cases)
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
                    target = _target(load, shorter, steps.cases)
                    predicted = predict(target).after(predicted)
        aim = tolerance if target == 1.0 else steps.path_tolerance
        solve = equilibrium.solve(target, aim, predicted=predicted)
        step = steps.after(solve, target - load)
        if solve.outcome.accepted:
            load, has_tangent = target, True
        else:
            state.array[:] = accepted
            ahead.failures.append((load, target))
            has_tangent = False  # the factors at hand are of a state that was given up
        yield solve
        if not solve.outcome.accepted and (
            step < steps.least or solve.outcome is Outcome.INTERRUPTED or (not patient and ahead.seen_from(load))
        ):
            return


def _target(load: float, step: float, cases: int) -> float:
    """The next load, not beyond the end of the present load case."""
    end = min((math.floor(load * cases + 1e-9) + 1) / cases, 1.0)
    # A remainder that is only rounding error is no step of its own.
    return end if load + step > end - 1e-9 / cases else load + step
