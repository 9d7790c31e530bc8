"""Monitor of Newton's method, which goes by the corrections and not by the residual, and reports of its solves.

On slender and nearly incompressible bodies the residual first rises by orders of magnitude while the corrections
already shrink. Corrections also estimate the error: with a contraction ``θ`` of successive corrections it is about
``θ/(1-θ)`` times the last one (Deuflhard, *Newton Methods for Nonlinear Problems*, 2011,
doi:10.1007/978-3-642-23899-4).
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from hpcinv.model.outcome import Outcome
from hpcinv.solver.predictor import Increment

type Tolerance = float | Callable[[float], float]


SERIES, SWITCHED = "power series", "branch switching"
"""strategies of solves by power series, and of solves that leave the path at a bifurcation"""


@dataclass(frozen=True)
class NewtonIteration:
    """One iteration: norms of correction, state and residual (scaled), and whether it had a new tangent."""

    correction: float
    state: float
    residual: float
    new_tangent: bool


@dataclass(frozen=True)
class Solve:
    """Report of one solve at a fixed load factor.

    Attributes:
        iterations: of Newton's method; empty if a test that the user's options chose ended the solve.
        factorizations: number of tangents that were factorized.
        signs: signs of their determinants, empty if the linear solver does not give them; where the sign changes, the
            number of negative eigenvalues has changed by an odd number.
        position_residual: distance of the loaded body from the given one (m) after a step of a fixed-point method.
        linear_iterations: iterations of the Krylov solver, if there is one.
        limit_point: whether the load has an extremum along the path here.
        bifurcation: load factor between the last accepted solve and this one at which other paths branch off.
        mode: unit vector along which the largest displacement of such a path begins.
        may_have_jumped: whether a load step moved the body so far that it may have left the path (`load_stepping`).
    """

    load: float
    outcome: Outcome
    iterations: tuple[NewtonIteration, ...]
    factorizations: int
    signs: tuple[int, ...] = ()
    position_residual: float | None = None
    linear_iterations: int = 0
    strategy: str = "load steps"
    limit_point: bool = False
    bifurcation: float | None = None
    mode: tuple[float, ...] = ()
    may_have_jumped: bool = False


@dataclass(frozen=True)
class CoarseSolve:
    """Report of the solve on coarser cells.

    Attributes:
        cells, unknowns: their numbers; 0 if there is no such mesh.
        solves: all solves on the way to the full load.
        unused: reason why the given mesh's solution was not found from it; empty if it was.
    """

    cells: int = 0
    unknowns: int = 0
    solves: tuple[Solve, ...] = ()
    unused: str = ""

    @property
    def factorizations(self) -> int:
        return sum(solve.factorizations for solve in self.solves)

    def as_data(self) -> dict[str, Any]:
        """Return the entry of the summary, as JSON data."""
        return {
            "cells": self.cells,
            "unknowns": self.unknowns,
            "factorizations": self.factorizations,
            "newton_iterations": sum(len(solve.iterations) for solve in self.solves),
            "load": max((solve.load for solve in self.solves if solve.outcome.accepted), default=0.0),
            "unused": self.unused or None,
        }


def is_given_up(solves: Sequence[Solve], patience: int) -> bool:
    """Return whether failed solves have taken more factorizations than ``solver.patience`` allows."""
    return sum(solve.factorizations for solve in solves if not solve.outcome.accepted) > patience


class Floor:
    """Norm of the state below which its size means nothing: the state that would result if no loads were balanced.

    Args:
        norm: returns it; called once at most, when it is first needed.
        largest: its largest possible value, without which most solves would evaluate it.
    """

    def __init__(self, norm: Callable[[], float] = lambda: 0.0, largest: float = 0.0) -> None:
        self._norm, self._largest = norm, largest

    def exceeds(self, size: float, share: float) -> bool:
        """Return whether a share of the floor exceeds a size, or equals it."""
        return size <= share * self._largest and size <= share * self._value

    @cached_property
    def _value(self) -> float:
        return self._norm()


@dataclass
class NewtonMonitor:
    """Decides after each correction whether to stop, and whether the next one needs a new tangent.

    Args:
        tolerance: estimated error of the state, relative to its norm; a solve ends below it. A function returns it from
            the sum of the corrections, relative to the state.
        reuse: largest contraction at which a tangent is kept (Shamanskii's method); 0 is full Newton.
        begins_near: whether the initial state is known to be near the solution.
        predicted: length of the step along the tangent that predicted the initial state; 0 without a prediction.
        inexact: relative error of a correction that the linear solver leaves.
        growths_allowed: number of iterations in which the correction may grow; with more of them it has diverged.
        keeps: whether the first correction is tried with the last tangent of the solve before, which was near.
        floor: corrections are compared with it where the state is smaller, as where its exact value is zero.
    """

    tolerance: Tolerance
    limit: int
    reuse: float
    begins_near: bool = False
    predicted: float = 0.0
    inexact: float = 0.0
    growths_allowed: int = 2
    keeps: bool = False
    floor: Floor = field(default_factory=Floor)
    history: list[NewtonIteration] = field(default_factory=list)

    # Far from the solution the first corrections may shrink by chance: a tangent assembled there must not be kept.
    close_correction = 0.02
    # The first correction with a new tangent, if as small as this, keeps it where the initial state is known to be near
    # the solution.
    first_close_correction = 5e-3
    # Corrections smaller than this that no longer shrink are rounding errors.
    round_off = 1e-8
    # A correction below this share of the floor is a rounding error. A larger share ends solves earlier, with fewer
    # digits of displacements that are much smaller than the nominal one.
    rounding = 1e-13
    # A correction by a kept tangent that exceeds the one before by more than this is computed with a new tangent.
    renewal = 1.0
    # The solve ends at a correction, except the first, whose rotation (rad) or strain exceeds this.
    too_far = 10.0

    @property
    def contraction(self) -> float:
        """Ratio of the last two corrections; 1 as long as there is only one."""
        if len(self.history) < 2:
            return 1.0
        previous, last = self.history[-2].correction, self.history[-1].correction
        return last / previous if previous > 0 else 0.0

    @property
    def needs_new_tangent(self) -> bool:
        """True if the next correction needs a new tangent."""
        if not self.history:
            return not ((self.predicted or self.keeps) and self.reuse)
        last = self.history[-1]
        tangents = sum(iteration.new_tangent for iteration in self.history)
        is_first = len(self.history) == 1 if self.keeps else last.new_tangent and tangents == 1
        if is_first and self.begins_near and last.correction <= self.first_close_correction * last.state:
            return False
        theta = self.contraction
        if len(self.history) == 1 and self.predicted:
            theta = last.correction / self.predicted
        return not (theta <= self.reuse and last.correction <= self.close_correction * last.state)

    @property
    def _tolerance(self) -> float:
        if not callable(self.tolerance):
            return self.tolerance
        size = self.history[-1].state
        return self.tolerance(sum(iteration.correction for iteration in self.history) / size if size else 0.0)

    def accepts(self, correction: float, state: float) -> bool:
        """Return whether a correction by a kept tangent is good enough; else it needs a new tangent at the same state.

        The test costs no factorization (Deuflhard's simplified correction).
        """
        if self.floor.exceeds(correction, self.rounding):
            return True
        if not self.history and self.keeps:
            return correction <= self.first_close_correction * state
        if not self.history:
            return correction <= self.reuse * self.predicted and correction <= self.close_correction * state
        return correction <= self.renewal * self.history[-1].correction

    def exceeds_prediction(self, correction: float, ratio: float) -> bool:
        """Return whether the first correction exceeds the prediction by more than a ratio."""
        return not self.history and self.predicted > 0 and correction > ratio * self.predicted

    def is_too_large(self, increment: Increment) -> bool:
        """Return whether the rotation or strain of the next correction shows that the solve has failed."""
        is_first = not self.history and not self.predicted
        return not is_first and not (increment.rotation <= self.too_far and increment.strain <= self.too_far)

    def judge(self, iteration: NewtonIteration) -> Outcome | None:
        """Add an iteration to the history and return the outcome, ``None`` if the solve continues."""
        self.history.append(iteration)
        if not (math.isfinite(iteration.correction) and math.isfinite(iteration.residual)):
            return Outcome.NOT_FINITE
        theta, last, size = max(self.contraction, self.inexact), iteration.correction, iteration.state
        if last == 0.0 or (theta < 1 and last * theta / (1 - theta) <= self._tolerance * size):
            return Outcome.CONVERGED
        if self.floor.exceeds(last, self.rounding):
            return Outcome.ROUND_OFF
        shrinks_no_more = theta > 0.5 and iteration.new_tangent and len(self.history) > 1
        if shrinks_no_more and (last <= self.round_off * size or self.floor.exceeds(last, self.round_off)):
            return Outcome.ROUND_OFF
        if len(self.history) >= self.limit:
            return Outcome.ITERATION_LIMIT
        growths = sum(
            following.correction > previous.correction for previous, following in itertools.pairwise(self.history)
        )
        return Outcome.DIVERGED if growths > self.growths_allowed else None
