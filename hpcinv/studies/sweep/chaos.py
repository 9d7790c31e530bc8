"""Polynomial chaos: orthonormal polynomials of independent parameters, fitted by least squares, and Sobol indices.

A quantity is written as a sum of products of Legendre polynomials (uniform parameters) and Hermite polynomials (normal
ones) up to a total degree. All products have mean 0 and variance 1 and are uncorrelated, so that the square of a
coefficient is the variance that its product contributes.

The degree has the smallest leave-one-out error, which follows exactly from one fit: the error of the surrogate
made without case i, at case i, is the residual of that case divided by 1 - hᵢ, where h is the diagonal of the
projection onto the polynomials (the hat matrix).

Source: Sudret, "Global sensitivity analysis using polynomial chaos expansions" (2008), doi:10.1016/j.ress.2007.04.002;
Allen (1974), doi:10.1080/00401706.1974.10489157, for the leave-one-out error; Wu (1986), doi:10.1214/aos/1176350142,
for the bootstrap; Gamboa, Janon, Klein & Lagnoux (2014), doi:10.1214/14-EJS895, for indices of several values together.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.stats
from numpy.polynomial import hermite_e, legendre

from hpcinv.mesh.source import Floats, Ints

OVERSAMPLING = 2
"""smallest number of cases for each term of a surrogate"""
HIGHEST = 12
"""highest total degree, which only a sample of few parameters could exceed"""
GOOD = 0.95
"""share of the variance (Q²) that a surrogate must predict for its indices to count"""
_CONDITION = 1e8  # of the polynomials at the sample, above which a degree is not used
_LONG_TAIL = 1.0  # excess kurtosis; a uniform sample has -1.2, a normal one 0
_RESAMPLES, _SEED = 1000, 20080701


def terms(parameters: int, degree: int) -> int:
    """Return the number of polynomials of a total degree."""
    return math.comb(parameters + degree, degree)


def cases_needed(parameters: int, degree: int) -> int:
    """Return the smallest number of cases to which a surrogate of a degree is fitted."""
    return OVERSAMPLING * terms(parameters, degree)


def exponents(parameters: int, degree: int) -> Ints:
    """Return the degree of each polynomial in each parameter, (terms, parameters), by increasing total degree."""
    chosen = (
        np.bincount(np.array(which, dtype=np.int64), minlength=parameters)
        for total in range(degree + 1)
        for which in itertools.combinations_with_replacement(range(parameters), total)
    )
    return np.array(list(chosen), dtype=np.int64)


def polynomials(points: Floats, normal: Sequence[bool], powers: Ints) -> Floats:
    """Return the orthonormal polynomials at points, (cases, terms).

    Args:
        points: (cases, parameters), in [-1, 1], or with mean 0 and standard deviation 1 where ``normal``.
        powers: degree of each polynomial in each parameter, (terms, parameters).
    """
    products = np.ones((len(points), len(powers)))
    degree = int(powers.max(initial=0))
    degrees = np.arange(degree + 1)
    for x, is_normal, power in zip(points.T, normal, powers.T, strict=True):
        if is_normal:
            values = hermite_e.hermevander(x, degree) / np.sqrt([math.factorial(k) for k in degrees.tolist()])
        else:
            values = legendre.legvander(x, degree) * np.sqrt(2 * degrees + 1)
        products *= values[:, power]
    return products


@dataclass(frozen=True)
class Surrogate:
    """Polynomials fitted to one or several values of each case.

    Attributes:
        powers: degree of each polynomial in each parameter, (terms, parameters).
        coefficients: (terms, values).
        errors: leave-one-out errors, (cases, values).
    """

    degree: int
    powers: Ints
    coefficients: Floats
    errors: Floats

    def predict(self, points: Floats, normal: Sequence[bool]) -> Floats:
        """Return the values that it predicts, (points, values)."""
        values: Floats = polynomials(points, normal, self.powers) @ self.coefficients
        return values

    @property
    def mean(self) -> Floats:
        """Mean of each value, (values)."""
        means: Floats = self.coefficients[0]
        return means

    @property
    def variances(self) -> tuple[Floats, Floats, Floats]:
        """First-order and total partial variances, (parameters, values), and the variance (values)."""
        squares = self.coefficients**2
        alone, involved = _members(self.powers)
        return alone.T @ squares, involved.T @ squares, squares[1:].sum(axis=0)


class Regression:
    """Least squares on the polynomials at the points of a sample.

    Args:
        points, normal: as in `polynomials`.

    Raises:
        ValueError: the points do not determine a surrogate of degree 1.
    """

    def __init__(self, points: Floats, normal: Sequence[bool]) -> None:
        cases, parameters = points.shape
        degrees = [p for p in range(HIGHEST + 1) if cases_needed(parameters, p) <= cases]
        if len(degrees) < 2:
            raise ValueError(f"a surrogate of degree 1 needs {cases_needed(parameters, 1)} cases")
        self.powers = exponents(parameters, degrees[-1])
        # Polynomials of a lower degree are the first columns: one factorization serves all degrees.
        self._q, self._r = scipy.linalg.qr(polynomials(points, normal, self.powers), mode="economic")
        counts = [terms(parameters, p) for p in degrees]
        with np.errstate(all="ignore"):
            usable = [n for n in counts if np.linalg.cond(self._r[:n, :n]) < _CONDITION]
        if len(usable) < 2:
            raise ValueError("the points of the sample lie too close together")
        self._counts = usable

    def fit(self, values: Floats) -> Surrogate:
        """Return the surrogate of values (cases, values) with the smallest leave-one-out error over all of them."""
        projections = self._q.T @ values
        count = min(self._counts, key=lambda n: float(np.sum(self._errors(values, projections[:n]) ** 2)))
        return self._surrogate(values, projections[:count])

    def fit_as(self, values: Floats, other: Surrogate) -> Surrogate:
        """Return the surrogate of values with the degree of another one."""
        return self._surrogate(values, self._q[:, : len(other.powers)].T @ values)

    def _surrogate(self, values: Floats, projections: Floats) -> Surrogate:
        powers = self.powers[: len(projections)]
        errors = self._errors(values, projections)
        return Surrogate(int(powers.sum(axis=1).max()), powers, self._solved(projections), errors)

    def _errors(self, values: Floats, projections: Floats) -> Floats:
        """Return the leave-one-out errors of the fit by the first columns."""
        q = self._q[:, : len(projections)]
        left = np.maximum(1 - np.sum(q**2, axis=1), np.finfo(float).eps)
        errors: Floats = (values - q @ projections) / left[:, None]
        return errors

    def changes(self, surrogate: Surrogate, column: int, signs: Floats) -> Floats:
        """Return the changes of a column's coefficients, (terms, n), when its errors are added with ``signs``."""
        q = self._q[:, : len(surrogate.powers)]
        return self._solved(q.T @ (surrogate.errors[:, column, None] * signs))

    def _solved(self, right: Floats) -> Floats:
        count = len(right)
        coefficients: Floats = scipy.linalg.solve_triangular(self._r[:count, :count], right)
        return coefficients


class Bounded(NamedTuple):
    """An estimate with its confidence interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Indices:
    """Sobol indices of one value of each case, or of several values together, whose variances are added.

    Attributes:
        q2: share of the variance that the surrogate predicts at cases that are left out; negative if it is worse than
            the mean.
        first, total: of each parameter.
        kurtosis: excess kurtosis of the values, 0 for normal ones.
    """

    degree: int
    terms: int
    q2: float
    sd: Bounded
    first: tuple[Bounded, ...]
    total: tuple[Bounded, ...]
    kurtosis: float

    @property
    def has_long_tail(self) -> bool:
        """True if rare values carry so much of the variance that the intervals are too narrow."""
        return self.kurtosis > _LONG_TAIL

    @property
    def decided(self) -> bool:
        """True if the surrogate is good enough for its indices to count."""
        return self.q2 >= GOOD

    @property
    def interactions(self) -> float:
        """Share of the surrogate's variance that belongs to no parameter alone."""
        return 1 - sum(index.value for index in self.first)


def predicted(errors: Floats, values: Floats) -> float:
    """Return Q²: 1 - sum of squared leave-one-out errors / sum of squared deviations from the mean."""
    return 1 - float(np.sum(errors**2) / np.sum((values - values.mean(axis=0)) ** 2))


def sobol_indices(regression: Regression, surrogate: Surrogate, values: Floats, confidence: float) -> Indices:
    """Return the Sobol indices of a surrogate of values (cases, values) that are not all constant.

    The intervals are a bootstrap's: leave-one-out errors are added to the cases with random signs, and the
    surrogate is fitted again. The squares of its coefficients are too large on average by their variance, which the
    reflected ("basic") interval takes out. The variance that the surrogate does not predict may belong to any
    parameter: the low ends take it to belong to others, the high ends to the parameter itself.
    """
    cases, columns = values.shape
    signs = _signs(cases)
    squares = np.zeros((len(surrogate.powers), _RESAMPLES + 1))  # the last one is the surrogate itself
    for column in range(columns):
        coefficients = surrogate.coefficients[:, column, None]
        squares[:, :-1] += (coefficients + regression.changes(surrogate, column, signs)) ** 2
        squares[:, -1:] += coefficients**2
    alone, involved = _members(surrogate.powers)
    whole = squares[1:].sum(axis=0)
    unexplained = float(np.sum(surrogate.errors**2)) / cases
    tail = (1 - confidence) / 2

    def bounded(value: float, lows: Floats, highs: Floats, limit: float) -> Bounded:
        low = 2 * lows[-1] - np.quantile(lows[:-1], 1 - tail)
        high = 2 * highs[-1] - np.quantile(highs[:-1], tail)
        return Bounded(value, float(np.clip(low, 0.0, value)), float(np.clip(high, value, limit)))

    def share(part: Floats) -> Bounded:
        value = float(part[-1] / whole[-1]) if whole[-1] > 0 else 0.0
        return bounded(value, part / (whole + unexplained), (part + unexplained) / (whole + unexplained), 1.0)

    variance = bounded(float(whole[-1]), whole, whole + unexplained, math.inf)
    return Indices(
        surrogate.degree,
        len(surrogate.powers),
        predicted(surrogate.errors, values),
        Bounded(*(math.sqrt(v) for v in variance)),
        tuple(share(part) for part in alone.T @ squares),
        tuple(share(part) for part in involved.T @ squares),
        float(scipy.stats.kurtosis(values).max()),
    )


def mean(regression: Regression, surrogate: Surrogate, confidence: float) -> Bounded:
    """Return the mean of the one value of a surrogate, with the interval of the same bootstrap."""
    changes = regression.changes(surrogate, 0, _signs(len(surrogate.errors)))[0]
    value, tail = float(surrogate.mean[0]), (1 - confidence) / 2
    return Bounded(value, value - float(np.quantile(changes, 1 - tail)), value - float(np.quantile(changes, tail)))


def _signs(cases: int) -> Floats:
    return np.random.default_rng(_SEED).choice([-1.0, 1.0], (cases, _RESAMPLES))


def _members(powers: Ints) -> tuple[Floats, Floats]:
    """Return which polynomials contain each parameter alone, and which contain it at all, (terms, parameters)."""
    involved = powers > 0
    alone = involved & (involved.sum(axis=1) == 1)[:, None]
    return alone.astype(float), involved.astype(float)
