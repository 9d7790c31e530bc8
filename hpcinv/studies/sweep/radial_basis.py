"""Interpolation of vectors over the numbers of jobs, by Gaussian radial basis functions.

Values are ``mean + Σ w_i exp(-|ξ - ξ_i|²/ℓ²)``, where coordinates ξ are logarithms of numbers of one sign, scaled by
their range, without the directions in which the given points do not vary. The width ℓ has the smallest error at points
that are left out one by one.

Source: Rippa, Adv. Comput. Math. 11, 193-210, 1999, doi:10.1023/A:1018975909870 (leave-one-out errors without refits).
"""

from collections.abc import Sequence

import numpy as np

from hpcinv.mesh.source import Floats

_WIDTHS = 2.0 ** np.arange(-1, 5)
"""Widths that are tried, in ranges of the coordinates. Larger ones: smoother, and the matrix is nearly singular."""
_NUGGET = 1e-11
"""Added to the diagonal, relative to it. Larger: less exact at the points; smaller: rounding errors of wide ones."""
_FLAT = 1e-9
"""Extent of the points in a direction, relative to the largest, below which it is left out: rounding errors."""


class RadialBasis:
    """Interpolation of values (n, m) at points with some numbers (n, d).

    Attributes:
        errors: of the values at each point that is predicted from all others, (n, m).
    """

    def __init__(self, numbers: Sequence[Sequence[float]], values: Floats) -> None:
        given = np.array(numbers, dtype=np.float64).reshape(len(numbers), -1)
        self._signs = np.where((np.sign(given) == np.sign(given[0])).all(axis=0), np.sign(given[0]), 0.0)
        points = self._transformed(given)
        self._origin, extent = points.min(axis=0), np.ptp(points, axis=0)
        self._varies = extent > _FLAT * np.maximum(np.abs(points).max(axis=0), 1.0)
        self._extent = np.where(self._varies, extent, 1.0)
        scaled = ((points - self._origin) / self._extent) * self._varies
        self._center = scaled.mean(axis=0)
        _, sizes, axes = np.linalg.svd(scaled - self._center, full_matrices=False)
        self._axes = axes[sizes > _FLAT * max(sizes.max(initial=0.0), _FLAT)]
        self._points = (scaled - self._center) @ self._axes.T
        self._mean = values.mean(axis=0)
        fits = [self._fit(width, values - self._mean) for width in _WIDTHS]
        self._width, self._weights, self.errors = min(fits, key=lambda fit: float((fit[2] ** 2).sum()))

    def outside(self, numbers: Sequence[float]) -> float:
        """Return how far numbers lie outside of the ranges of the given points, as a multiple of these ranges.

        It is infinite for numbers outside the space of the given points. Numbers that do not vary among the points must
        agree with them.
        """
        if ((self._signs != 0) & (np.sign(numbers) != self._signs)).any():
            return np.inf
        scaled = (self._transformed(np.array(numbers)) - self._origin) / self._extent
        beyond = float((np.abs(scaled - 0.5) - 0.5)[self._varies].max(initial=0.0))
        is_off = np.abs(self._residual(scaled)).max(initial=0.0) > np.sqrt(_FLAT)
        return np.inf if is_off else max(beyond, 0.0)

    def nearest(self, numbers: Sequence[float]) -> int:
        """Return the place of the nearest point."""
        return int(np.argmin(self._distances(self._reduced(numbers))))

    def __call__(self, numbers: Sequence[float]) -> Floats:
        """Return the values (m,) at some numbers."""
        kernel = np.exp(-((self._distances(self._reduced(numbers)) / self._width) ** 2))
        return np.asarray(self._mean + kernel @ self._weights)

    def _fit(self, width: float, values: Floats) -> tuple[float, Floats, Floats]:
        """Return width, weights and errors at points that are left out."""
        distances = np.linalg.norm(self._points[:, None] - self._points[None], axis=2)
        kernel = np.exp(-((distances / width) ** 2)) + _NUGGET * np.eye(len(values))
        inverse = np.linalg.inv(kernel)
        weights = inverse @ values
        return width, weights, weights / np.diag(inverse)[:, None]

    def _transformed(self, numbers: Floats) -> Floats:
        """Return logarithms of numbers of one sign."""
        has_sign = self._signs != 0
        return np.where(has_sign, np.log(np.where(has_sign, np.abs(numbers), 1.0)), numbers)

    def _residual(self, scaled: Floats) -> Floats:
        """Return the part of scaled coordinates in directions in which the points do not vary."""
        centred = scaled - self._center
        return np.asarray(centred - (centred @ self._axes.T) @ self._axes)

    def _reduced(self, numbers: Sequence[float]) -> Floats:
        scaled = (self._transformed(np.array(numbers)) - self._origin) / self._extent
        return np.asarray((scaled - self._center) @ self._axes.T)

    def _distances(self, point: Floats) -> Floats:
        return np.asarray(np.linalg.norm(self._points - point, axis=1))
