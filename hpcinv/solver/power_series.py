"""Paths of equilibria as power series, their Padé approximants, and the range in which these hold.

Near an equilibrium ``(x₀, λ₀)`` the path is ``x(a) = Σ xₖ aᵏ``, ``λ(a) = Σ λₖ aᵏ`` with the parameter

    a = ⟨x - x₀, x₁⟩/s² + (λ - λ₀) λ₁,

of the length of the path in states over a scale ``s`` and the load. Each order has one right-hand side and the same
matrix: with ``K t = -∂R/∂λ``, and with the coefficient ``Rₖ`` of the residual for ``xₖ = 0`` and ``λₖ = 0``,

    K wₖ = -Rₖ,    xₖ = λₖ t + wₖ,    λₖ (⟨t, x₁⟩/s² + λ₁) = -⟨wₖ, x₁⟩/s².

Padé approximants with one denominator for all unknowns reach farther than polynomials.

Sources: Cochelin, Comput. Struct. 53, 1181–1192, 1994, doi:10.1016/0045-7949(94)90165-1; Chen et al., ACM Trans. Graph.
33, 2014, doi:10.1145/2601097.2601189.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hpcinv.parallel.runtime import MPI

type Reals = npt.NDArray[np.float64]

_GROWTH = 1.05  # factor between parameters that are tried; the range is short of its end by this factor at most
_FARTHEST = 50.0  # times the range of the polynomials, up to which Padé approximants are tried
_SAMPLES = 100  # loads along a range; two limit points between two of them are not seen
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

    states: Reals
    loads: Reals
    load: float
    scale: float
    factors: Reals

    @classmethod
    def of(cls, states: Reals, loads: Reals, load: float, scale: float, comm: MPI.Intracomm) -> PowerSeries:
        """Return a series of coefficients; collective."""
        # The load is counted on one rank.
        rows = np.column_stack([states / scale, loads if comm.rank == 0 else np.zeros_like(loads)])
        return cls(states, loads, load, scale, _orthonormal(rows, comm))

    def weights(self, a: float, *, pade: bool, orders: int | None = None) -> Reals:
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

    def load_at(self, weights: Reals) -> float:
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

    def at_load(self, load: float, accuracy: float) -> tuple[Reals, float] | None:
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

    def error(self, a: float, *, pade: bool) -> float:
        """Return the distance of the two last orders at ``a``, relative to the distance from the beginning."""
        last, before = (self.weights(a, pade=pade, orders=n) for n in (len(self.loads), len(self.loads) - 1))
        return float(np.linalg.norm((last - before) @ self.factors) / np.linalg.norm(last @ self.factors))

    def _denominator(self, orders: int) -> Reals:
        """Return the coefficients of the denominator of a Padé approximant, from order 0 on."""
        f, d = self.factors, np.zeros(orders)
        d[0] = 1.0
        for i in range(1, orders):
            row = orders - 1 - i
            d[i] = -sum(d[j] * f[orders - 1 - j, row] for j in range(i)) / (f[row, row] or 1.0)
        return d


def _orthonormal(rows: Reals, comm: MPI.Intracomm) -> Reals:
    """Return the lower triangular factors of rows in an orthonormal basis of them, each rank having some columns."""
    count = len(rows)
    basis, factors = np.zeros_like(rows), np.zeros((count, count))
    for k, row in enumerate(rows):
        rest = row.copy()
        for _ in range(2):  # the second time removes what rounding has left
            shares = comm.allreduce(basis[:k] @ rest)
            factors[k, :k] += shares
            rest -= shares @ basis[:k]
        size = float(np.sqrt(comm.allreduce(rest @ rest)))
        factors[k, k] = size
        basis[k] = rest / (size or 1.0)
    return factors
