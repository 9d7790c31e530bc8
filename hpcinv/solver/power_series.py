"""Paths of equilibria as power series, their Padé approximants, and the range in which these hold.

Near an equilibrium ``(x₀, λ₀)`` the path is ``x(a) = Σ xₖ aᵏ``, ``λ(a) = Σ λₖ aᵏ`` with the parameter

    a = ⟨x - x₀, x₁⟩/s² + (λ - λ₀) λ₁,

of the length of the path in states over a scale ``s`` and the load. Each order has one right-hand side and the same
matrix: with ``K t = -∂R/∂λ``, and with the coefficient ``Rₖ`` of the residual for ``xₖ = 0`` and ``λₖ = 0``,

    K wₖ = -Rₖ,    xₖ = λₖ t + wₖ,    λₖ (⟨t, x₁⟩/s² + λ₁) = -⟨wₖ, x₁⟩/s².

Padé approximants with one denominator for all unknowns reach farther than polynomials.

Near a bifurcation at ``a = c`` the coefficients end in a geometric progression, ``xₖ ≈ xₖ₋₁/c``, along the direction of
the other path: rounding errors and imperfections begin it, and it outlives the coefficients of the smooth path.

Sources: Cochelin, Comput. Struct. 53, 1181–1192, 1994, doi:10.1016/0045-7949(94)90165-1; Chen et al., ACM Trans. Graph.
33, 2014, doi:10.1145/2601097.2601189; Cochelin & Médale, J. Comput. Phys. 236, 594–607, 2013,
doi:10.1016/j.jcp.2012.11.016.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import Floats

_GROWTH = 1.05  # factor between parameters that are tried; the range is short of its end by this factor at most
_FARTHEST = 50.0  # times the range of the polynomials, up to which Padé approximants are tried
_SAMPLES = 100  # loads along a range; two limit points between two of them are not seen
_PROGRESSION = 1e-2
"""Largest relative difference of a coefficient in a geometric progression from a multiple of the one before. A larger
one takes other series for a progression, which costs a factorization each time."""
_STEADY = 1e-3  # largest relative change of its ratio in the last two orders
_DEPENDENT = 1e-13  # part of a coefficient, relative to it, that is rounding errors of its projections on others
_POLE = 0.98  # share of the distance of the first pole of the denominator that the range may reach


@dataclass(frozen=True)
class PowerSeries:
    """A path near one of its points.

    Attributes:
        states: coefficients of the owned unknowns from order 1 on, (orders, n).
        loads: coefficients of the load factor, (orders,).
        load: load factor at ``a = 0``.
        scale: ``s``.
        factors: coefficients ``(xₖ/s, λₖ)`` in an orthonormal basis, (orders, orders), lower triangular.
    """

    states: Floats
    loads: Floats
    load: float
    scale: float
    factors: Floats

    def weights(self, a: float, *, pade: bool, orders: int | None = None) -> Floats:
        """Return the factors of all coefficients at ``a``, by polynomials or by Padé approximants of some orders."""
        count = len(self.loads)
        orders = orders or count
        factors = np.zeros(count)
        powers = a ** np.arange(1, count + 1)
        if not pade:
            factors[:orders] = powers[:orders]
            return factors
        # Partial sums of the denominator; the last one is the denominator.
        sums = np.cumsum(self._denominator(orders) * a ** np.arange(orders))
        factors[: orders - 1] = powers[: orders - 1] * sums[-2::-1] / sums[-1]
        return factors

    def load_at(self, weights: Floats) -> float:
        return self.load + float(weights @ self.loads)

    def range(self, accuracy: float) -> tuple[float, bool]:
        """Return the largest parameter at which the two last orders agree, and whether by Padé approximants.

        Args:
            accuracy: largest distance of the two, relative to the distance from the beginning.
        """
        orders = len(self.loads)
        first, last = np.linalg.norm(self.factors[[0, -1]], axis=1)
        if last == 0.0:
            return np.inf, False
        polynomial = float((accuracy * first / last) ** (1 / (orders - 1)))
        roots = np.roots(self._denominator(orders)[::-1])
        real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0)]
        end = min(_POLE * real.min(initial=np.inf), _FARTHEST * polynomial)
        a = polynomial
        while a * _GROWTH < end and self.error(a * _GROWTH, pade=True) <= accuracy:
            a *= _GROWTH
        return a, a > polynomial

    def at_load(self, load: float, accuracy: float) -> tuple[Floats, float] | None:
        """Return the factors of all coefficients at a load factor, and the `error` there; ``None`` out of range.

        Args:
            accuracy: as of `range`, which counts in both directions of the path.
        """
        # Coefficients of the path in the other direction have alternating signs.
        signs = np.ones(len(self.loads)) if load >= self.load else (-1.0) ** np.arange(1, len(self.loads) + 1)
        way = replace(self, loads=signs * self.loads, factors=signs[:, None] * self.factors)
        high, is_pade = way.range(accuracy)
        if not np.isfinite(high):  # the path is straight
            return self.weights((load - self.load) / float(self.loads[0]), pade=False), 0.0

        def passes(a: float) -> bool:
            return bool((way.load_at(way.weights(a, pade=is_pade)) - load) * signs[0] >= 0)

        if not passes(high):
            return None
        low = 0.0
        for _ in range(100):
            middle = (low + high) / 2
            low, high = (low, middle) if passes(middle) else (middle, high)
        return signs * way.weights(high, pade=is_pade), way.error(high, pade=is_pade) if high else 0.0

    def limit(self, end: float, *, pade: bool) -> float | None:
        """Return the first parameter before ``end`` from which on the load falls, ``None`` if it never does."""
        if not np.isfinite(end):
            return None

        def load(a: float) -> float:
            return self.load_at(self.weights(a, pade=pade))

        grid = np.linspace(0.0, end, _SAMPLES + 1)
        falls = np.flatnonzero(np.diff([load(a) for a in grid]) < 0)
        if not len(falls):
            return None
        low, high = grid[max(falls[0] - 1, 0)], grid[falls[0] + 1]
        for _ in range(100):  # a third of the bracket is cut off each time
            left, right = (2 * low + high) / 3, (low + 2 * high) / 3
            low, high = (left, high) if load(left) < load(right) else (low, right)
        return float(low)

    def bifurcation(self) -> tuple[float, float] | None:
        """Return the parameter of a bifurcation and the load factor there, ``None`` without a geometric progression."""
        if len(self.loads) < 4:
            return None
        ratios = []
        for before, row in pairwise(self.factors[-3:]):
            size, length = np.linalg.norm(row), np.linalg.norm(before)
            ratio = float(row @ before) / float(length**2 or 1.0)
            if size == 0.0 or np.linalg.norm(row - ratio * before) > _PROGRESSION * size:
                return None
            ratios.append(ratio)
        if ratios[-1] <= 0 or abs(ratios[1] - ratios[0]) > _STEADY * ratios[1]:
            return None
        a, orders = 1 / ratios[-1], len(self.loads)
        # The progression itself has no sum there: what is left of the load without it is the path's.
        smooth = self.loads - self.loads[-1] * ratios[-1] ** (np.arange(1.0, orders + 1) - orders)
        return a, self.load + float(a ** np.arange(1, orders + 1) @ smooth)

    def error(self, a: float, *, pade: bool) -> float:
        """Return the distance of the two last orders at ``a``, relative to the distance from the beginning."""
        last, before = (self.weights(a, pade=pade, orders=n) for n in (len(self.loads), len(self.loads) - 1))
        return float(np.linalg.norm((last - before) @ self.factors) / np.linalg.norm(last @ self.factors))

    @cached_property
    def _denominators(self) -> dict[int, Floats]:
        return {}

    def _denominator(self, orders: int) -> Floats:
        """Return the coefficients of the denominator of a Padé approximant, from order 0 on."""
        if orders not in self._denominators:
            f, d = self.factors, np.zeros(orders)
            d[0] = 1.0
            for i in range(1, orders):
                row = orders - 1 - i
                d[i] = -(d[:i] @ f[orders - 1 : row : -1, row]) / (f[row, row] or 1.0)
            self._denominators[orders] = d
        return self._denominators[orders]


class Coefficients:
    """Coefficients of a path, order by order, with an orthonormal basis of them; methods are collective.

    Args:
        orders: largest number of them.
        size: number of owned unknowns.
        load, scale: as of `PowerSeries`.
    """

    def __init__(self, orders: int, size: int, load: float, scale: float, comm: MPI.Intracomm) -> None:
        self._load, self._scale, self._comm, self._count = load, scale, comm, 0
        self._states, self._loads = np.empty((orders, size)), np.empty(orders)
        self._basis, self._factors = np.zeros((orders, size + 1)), np.zeros((orders, orders))

    def add(self, state: Floats, load: float) -> None:
        """Add the coefficients of the next order."""
        k, self._count = self._count, self._count + 1
        self._states[k], self._loads[k] = state, load
        # The load is counted on one rank.
        row = np.append(state / self._scale, load if self._comm.rank == 0 else 0.0)
        rest = row.copy()
        for _ in range(2):  # the second time removes what rounding has left
            shares = self._comm.allreduce(self._basis[:k] @ rest)
            self._factors[k, :k] += shares
            rest -= shares @ self._basis[:k]
        whole, size = np.sqrt(self._comm.allreduce(np.array([row @ row, rest @ rest])))
        if size > _DEPENDENT * whole:  # rounding errors have no direction that is orthogonal to the basis
            self._factors[k, k] = size
            self._basis[k] = rest / size

    def series(self) -> PowerSeries:
        """Return the series of the orders so far."""
        n = self._count
        return PowerSeries(self._states[:n], self._loads[:n], self._load, self._scale, self._factors[:n, :n])
