"""Weighted least squares of a law's parameters, and their covariance."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import attrgetter, getitem
from typing import Any

import numpy as np
import scipy.optimize
import scipy.special
from pydantic import ValidationError

from hpcinv.base.quantity.arrays import Floats
from hpcinv.base.quantity.schema import problems_in
from hpcinv.physics.materials import MaterialLaw
from hpcinv.studies.fitting.candidate import Candidate
from hpcinv.studies.fitting.equal_optima import Disagreement, Predictions, compare, different
from hpcinv.studies.fitting.homogeneous import Response
from hpcinv.studies.fitting.linearised import Linearised, correlation_of
from hpcinv.studies.fitting.measurements import Test

_DRAWS, _STARTS, _FINALISTS = 100, 8, 2  # random starting values; the best of them, and of these, are refined
_VOLUME_DRAWS, _VOLUME_EVALUATIONS = 4, 15  # random starts of a compressible law that is linear in its parameters
_MOST_MIRRORED = 3  # signs that are turned in all combinations; of more, each alone and all at once
_MOST_OPTIMA = 8  # equally good ones that are kept; raised, a poorly determined law takes longer
_CONFIDENCE = 0.95
_NEGLIGIBLE = 1e-6
"""Residual relative to the stress below which two fits are equally good, whatever the scatter is."""
_SEED = 20120610
_LARGEST = 1e50  # magnitude of residuals and slopes whose squares are far from overflow
_TOLERANCE, _FIRST_EVALUATIONS, _MOST_EVALUATIONS = 1e-13, 50, 1000


type Solution = scipy.optimize.OptimizeResult


class FitError(ValueError):
    """A law cannot be fitted to these tests; the message is the reason."""


@dataclass(frozen=True)
class Fit:
    """Parameters of a law that fit tests best.

    Attributes:
        values: of the parameters (SI), (k,).
        covariance: (k, k), from given standard deviations of the stress, or from the scatter around the fit.
        residuals: stress of the law minus measured stress of each test, in Pa.
        chi_squared: sum of squares of the residuals, relative to standard deviations if those are given.
        deviations_known: whether the standard deviations of the stress were given.
        law: with these values.
        rivals: values (SI) of other parameters that fit equally well, (k,) each.
        disagreements: where they differ in tests that were not made, most first.
    """

    candidate: Candidate
    tests: tuple[Test, ...]
    values: Floats
    covariance: Floats
    residuals: tuple[Floats, ...]
    chi_squared: float
    deviations_known: bool
    law: MaterialLaw
    rivals: tuple[Floats, ...] = ()
    disagreements: tuple[Disagreement, ...] = ()

    @property
    def count(self) -> int:
        """Number of points."""
        return sum(map(len, self.tests))

    @property
    def freedom(self) -> int:
        return self.count - len(self.values)

    @property
    def deviations(self) -> Floats:
        """Standard deviations of the parameters (SI), (k,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Floats:
        return correlation_of(self.covariance)

    @property
    def scatter(self) -> float:
        """Root of chi² per degree of freedom: in standard deviations if those are given, otherwise in Pa."""
        return float(np.sqrt(self.chi_squared / self.freedom))

    @cached_property
    def response(self) -> Response:
        return Response(self.candidate.law, self.candidate.places)

    def quality(self, number: int) -> tuple[float, float, float]:
        """Return root-mean-square residual (Pa), largest residual (Pa) and R² of a test."""
        return _quality(self.residuals[number], self.tests[number].stress)

    @property
    def r_squared(self) -> float:
        return _quality(np.concatenate(self.residuals), np.concatenate([t.stress for t in self.tests]))[2]

    @property
    def aicc(self) -> float:
        """Akaike's information criterion, corrected for few data; infinite if there are too few for it.

        Source: Hurvich & Tsai (1989), doi:10.1093/biomet/76.2.297.
        """
        n, k = self.count, len(self.values)
        if self.deviations_known:
            deviance = self.chi_squared
        else:
            k += 1  # the variance is estimated, too
            deviance = n * np.log(max(self.chi_squared, np.finfo(float).tiny) / n)
        return float(deviance + 2 * k + 2 * k * (k + 1) / (n - k - 1)) if n > k + 1 else np.inf


def _quality(residuals: Floats, stress: Floats) -> tuple[float, float, float]:
    squares, spread = float((residuals**2).sum()), float(((stress - stress.mean()) ** 2).sum())
    r_squared = 1 - squares / spread if spread > 0 else np.nan
    return float(np.sqrt(squares / len(stress))), float(np.abs(residuals).max()), r_squared


def fit(candidate: Candidate, tests: Sequence[Test]) -> Fit:
    """Fit the parameters of a law to tests.

    All points weigh alike, unless the tests have standard deviations. Parameters in which the stress is not linear
    begin at several values: published ones, and the best of some hundred random ones. Of optima that are equally good,
    one is preferred by the rule of ``equal_optima``; the others are its rivals.

    Raises:
        FitError: with the reason, which names the law.
    """
    problem = _LeastSquares(candidate, tests)
    problem.check()
    starts = problem.starts()
    first = _VOLUME_EVALUATIONS if problem.has_named_optimum else _FIRST_EVALUATIONS
    first = first if len(starts) > 1 else _MOST_EVALUATIONS
    solutions = [solution for start in starts if (solution := problem.solved(start, first)) is not None]
    if not solutions:
        raise FitError(
            f"{candidate.label}: no values were found for which the law is defined at all points; leave "
            "out large strains (--largest-stretch), or choose another law"
        )
    if len(starts) == 1:
        return problem.conclude(solutions)
    if problem.has_named_optimum:
        return problem.conclude(problem.equally_good(problem.refined(solutions[0]), _distinct(solutions)))
    distinct = _distinct(sorted(solutions, key=attrgetter("cost")))
    refined = sorted(map(problem.refined, distinct[:_FINALISTS]), key=attrgetter("cost"))
    mirrored = problem.mirrored(refined[0])
    return problem.conclude(problem.equally_good(refined[0], [*refined[1:], *mirrored, *distinct[_FINALISTS:]]))


def _distinct(solutions: Sequence[Solution]) -> list[Solution]:
    """Return solutions without those that have the same values as an earlier one."""
    kept: list[Solution] = []
    for solution in solutions:
        if not any(np.allclose(solution.x, other.x, rtol=1e-6, atol=0.0) for other in kept):
            kept.append(solution)
    return kept


class _LeastSquares:
    def __init__(self, candidate: Candidate, tests: Sequence[Test]) -> None:
        self._candidate, self._tests = candidate, tuple(tests)
        self._response = Response(candidate.law, candidate.places)
        self._data = np.concatenate([test.stress for test in tests])
        self._known = all(test.deviation is not None for test in tests)
        self._size = float(np.sqrt((self._data**2).mean())) or 1.0
        sizes = [test.deviation for test in tests if test.deviation is not None]
        self._deviation = np.concatenate(sizes) if self._known else np.full(len(self._data), self._size)
        self._is_stress = np.array([p.is_stress for p in candidate.parameters])
        self._lower, self._upper = (np.array([getattr(p, s) for p in candidate.parameters]) for s in ("lower", "upper"))
        # Parameters are divided by their sizes, so that steps are alike.
        self.unit = np.where(self._is_stress, self._size, 1.0)
        self._last: tuple[Floats, tuple[Floats, Floats]] | None = None  # values, and their stress

    def check(self) -> None:
        """Raise ``FitError`` if the tests cannot determine the parameters, whatever their values are."""
        k, n = len(self._candidate.parameters), len(self._data)
        label = self._candidate.label
        if n <= k:
            raise FitError(
                f"{label}: {n} points cannot determine {k} parameters and their standard deviations;"
                " choose a law with fewer, fix some (--fix), or add tests"
            )
        if self._response.is_incompressible and (only := [t.name for t in self._tests if t.mode.is_volumetric]):
            raise FitError(f"{label}: is incompressible, but {only[0]} is a volumetric test; give --compressible")

    def starts(self) -> list[Floats]:
        """Return starting values: one if the stress is linear in all parameters."""
        named = [self._candidate.start, *self._candidate.published()]
        if self._is_stress.all():
            first = self.linear_part_solved(named[0])
            return [first, *map(self.linear_part_solved, self._scaled())] if self._has_free_volume else [first]
        tried = [self.linear_part_solved(start) for start in (*named, *self._random())]
        costs = [self._cost_at(start) for start in tried]
        order = [i for i in np.argsort(costs, stable=True) if np.isfinite(costs[i])]
        distinct = {tuple(tried[i]): tried[i] for i in order}
        return list(distinct.values())[:_STARTS]

    @property
    def has_named_optimum(self) -> bool:
        """Whether the law is linear in its parameters but for the volume: its own start finds an optimum."""
        return bool(self._is_stress.all())

    @property
    def _has_free_volume(self) -> bool:
        """Whether the volume in the tests depends on the parameters, and then the stress is not linear in them."""
        return not self._response.is_incompressible and any(test.mode.free for test in self._tests)

    def _scaled(self) -> Iterator[Floats]:
        """Yield values whose ratios are drawn over several decades."""
        generator = np.random.default_rng(_SEED)
        for _ in range(_VOLUME_DRAWS):
            yield self._candidate.start * 10 ** generator.uniform(-1.5, 1.5, len(self._candidate.start))

    def _random(self) -> Iterator[Floats]:
        """Yield values drawn over several decades, within the bounds."""
        generator = np.random.default_rng(_SEED)
        start = self._candidate.start
        for _ in range(_DRAWS):
            size = 10 ** generator.uniform(-1.0, 2.0, len(start))
            sign = np.where(generator.random(len(start)) < 0.5, -1.0, 1.0)
            free = np.isneginf(self._lower)
            drawn = np.where(free, sign * size / 8, np.where(free, 0.0, self._lower) + size)
            is_bounded = np.isfinite(self._lower) & np.isfinite(self._upper)
            share = generator.random(len(start))
            span = np.where(is_bounded, self._upper - np.where(is_bounded, self._lower, 0.0), 0.0)
            drawn = np.where(is_bounded, np.where(is_bounded, self._lower, 0.0) + share * span, drawn)
            yield np.where(self._is_stress, start, np.minimum(drawn, self._upper))

    def linear_part_solved(self, values: Floats) -> Floats:
        """Return values whose stresses fit best, as energies are linear in parameters that are stresses."""
        linear = self._is_stress
        if not linear.any():
            return values
        matrix = self._jacobian(values / self.unit)[:, linear]
        if not (np.abs(matrix) < _LARGEST).all():
            return values
        bounds = (self._lower[linear] / self._size, self._upper[linear] / self._size)
        solution = scipy.optimize.lsq_linear(matrix, self._data / self._deviation, bounds=bounds)
        solved = values.copy()
        solved[linear] = solution.x * self._size
        return solved

    def solved(self, start: Floats, evaluations: int) -> Solution | None:
        """Return the least squares from a start; ``None`` if the law is not defined there."""
        x = np.clip(start / self.unit, self._inner_bound(self._lower, 1), self._inner_bound(self._upper, -1))
        if not (np.abs(self._residuals(x)) < _LARGEST).all():
            return None
        return scipy.optimize.least_squares(
            self._residuals,
            x,
            jac=self._jacobian,
            bounds=(self._lower / self.unit, self._upper / self.unit),
            x_scale="jac",
            ftol=_TOLERANCE,
            xtol=_TOLERANCE,
            gtol=_TOLERANCE,
            max_nfev=evaluations,
        )

    def refined(self, solution: Solution) -> Solution:
        """Return a solution from which iterations went on until they converged."""
        if solution.status > 0:
            return solution
        return self.solved(solution.x * self.unit, _MOST_EVALUATIONS) or solution

    def mirrored(self, solution: Solution) -> Iterator[Solution]:
        """Yield what fits equally well as a solution if pure numbers, such as exponents, change their signs."""
        values, level = solution.x * self.unit, self._equal_cost(solution)
        free = np.flatnonzero(~self._is_stress & (self._lower == -self._upper) & (values != 0))
        for signs in _turned_signs(len(free)):
            start = values.copy()
            start[free] *= signs
            start = self.linear_part_solved(start)
            if self._cost_at(start) / 2 <= level and (found := self.solved(start, _FIRST_EVALUATIONS)) is not None:
                yield found

    def _equal_cost(self, best: Solution) -> float:
        """Return the cost up to which solutions are as good as the best: within its confidence region."""
        n, k = best.jac.shape
        if self._known:
            allowed = scipy.special.chdtri(k, 1 - _CONFIDENCE) / 2
        else:
            allowed = best.cost * k / (n - k) * scipy.special.fdtri(k, n - k, _CONFIDENCE)
        return float(best.cost + allowed + ((_NEGLIGIBLE * self._size / self._deviation) ** 2).sum() / 2)

    def equally_good(self, best: Solution, others: Sequence[Solution]) -> list[Solution]:
        """Return the best solution, and others as good as it, each with other predictions than those before.

        If one of the others is better beyond chance, it takes the place of the best.
        """
        least = min([best, *others], key=attrgetter("cost"))
        if best.cost > self._equal_cost(least):
            best = self.refined(least)
        level = self._equal_cost(best)
        predictions = Predictions(self._response, self._tests)
        kept = [best]
        for other in others:
            if other.cost <= level and len(kept) < _MOST_OPTIMA and self._is_new(other, kept, predictions):
                kept.append(other)
        return kept

    def _is_new(self, solution: Solution, kept: Sequence[Solution], predictions: Predictions) -> bool:
        return different(predictions, solution.x * self.unit, [other.x * self.unit for other in kept])

    def _inner_bound(self, bound: Floats, sign: int) -> Floats:
        bound = bound / self.unit
        return bound + sign * 1e-10 * np.where(np.isfinite(bound), np.maximum(np.abs(bound), 1e-3), 0.0)

    def conclude(self, solutions: Sequence[Solution]) -> Fit:
        """Return the fit of the preferred one of solutions that are equally good, the best first."""
        values = [solution.x * self.unit for solution in solutions]
        self._check_determined(Linearised(solutions[0].jac))
        predictions = Predictions(self._response, self._tests)
        found = compare(predictions, self._tests, self._response, values, lambda i: self._covariance(solutions[i]))
        solution = self.refined(solutions[found.preferred])
        residuals = solution.fun * self._deviation
        chi_squared = float((solution.fun**2).sum()) * (1.0 if self._known else self._size**2)
        ends = np.cumsum([len(test) for test in self._tests])[:-1]
        return Fit(
            self._candidate,
            self._tests,
            solution.x * self.unit,
            self._covariance(solution),
            tuple(np.split(residuals, ends)),
            chi_squared,
            self._known,
            self._admitted(solution.x * self.unit),
            tuple(values[i] for i in found.others),
            found.disagreements,
        )

    def _covariance(self, solution: Solution) -> Floats:
        """Return the covariance (k, k) of the parameters (SI)."""
        n, k = solution.jac.shape
        variance = 1.0 if self._known else float((solution.fun**2).sum()) / (n - k)
        return np.asarray(variance * Linearised(solution.jac).covariance() * np.outer(self.unit, self.unit))

    def _check_determined(self, linear: Linearised) -> None:
        """Raise ``FitError`` if a combination of parameters changes no stress of the tests."""
        names = [parameter.name for parameter in self._candidate.parameters]
        label = self._candidate.label
        size = float(np.abs(self._data / self._deviation).max() * np.sqrt(len(self._data)))
        if idle := [names[i] for i in linear.idle(size)]:
            raise FitError(
                f"{label}: the tests do not depend on {' and '.join(idle)}: fix it (--fix {idle[0]}=…), or add a test "
                "that does"
            )
        if free := linear.free():
            involved = [names[i] for i in free[-1].involved]
            raise FitError(
                f"{label}: the tests do not separate {' and '.join(involved)}; fix all but one of them "
                f"(--fix {involved[-1]}=…), or add a test of another mode"
            )

    def _admitted(self, values: Floats) -> MaterialLaw:
        """Return the law with these values; ``FitError`` if it does not admit them."""
        law = type(self._candidate.law)
        section: Any = self._candidate.section([float(v) for v in values])
        try:
            return law.model_validate(section)
        except ValidationError as error:
            texts = [text for _, text in problems_in(error, law)]
            entries = [reduce(getitem, p.place, section) for p in self._candidate.parameters]
            shown = ", ".join(f"{p.name} = {e}" for p, e in zip(self._candidate.parameters, entries, strict=True))
            raise FitError(
                f"{self._candidate.label}: the values that fit best, {shown}, are not admissible: {'; '.join(texts)}; "
                "leave out large strains (--largest-stretch), or choose another law"
            ) from None

    def _stress(self, values: Floats) -> tuple[Floats, Floats]:
        """Return the stress (n,) at all points, and its slopes (n, k)."""
        if self._last is not None and np.array_equal(self._last[0], values):
            return self._last[1]
        parts = self._response.stresses([(t.mode, t.measure, t.is_cauchy) for t in self._tests], values)
        stress, slopes = zip(*parts, strict=True)
        self._last = values.copy(), (np.concatenate(stress), np.concatenate(slopes))
        return self._last[1]

    def _residuals(self, x: Floats) -> Floats:
        with np.errstate(all="ignore"):
            return np.asarray((self._stress(x * self.unit)[0] - self._data) / self._deviation)

    def _jacobian(self, x: Floats) -> Floats:
        with np.errstate(all="ignore"):
            return np.asarray(self._stress(x * self.unit)[1] * self.unit / self._deviation[:, None])

    def _cost_at(self, values: Floats) -> float:
        with np.errstate(all="ignore"):
            return float((self._residuals(values / self.unit) ** 2).sum())


def _turned_signs(count: int) -> Iterator[Floats]:
    """Yield signs (count,) of which some are -1: all combinations of a few, else each alone and all at once."""
    if count <= _MOST_MIRRORED:
        yield from (np.array(signs) for signs in itertools.product((1.0, -1.0), repeat=count) if -1.0 in signs)
        return
    yield from 1.0 - 2.0 * np.eye(count)
    yield -np.ones(count)
