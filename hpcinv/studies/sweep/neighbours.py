"""Initial guesses of cases, extrapolated from the solutions of their neighbours in parameter space.

The solution is a smooth function of the parameters, which moving least squares extrapolate to a new point: the guess is
the sum ``Σ c_i x_i`` over the nearest solved cases with points ``ξ_i``, whose weights reproduce all polynomials of a
degree, ``Σ c_i p(ξ_i) = p(ξ)``, and are larger for nearer cases. Degree 0 is the nearest solution alone, degree 1 a
linear extrapolation; with enough neighbours the error of degree 2 is cubic in their distance.

Source: Levin, "The approximation power of moving least-squares" (1998), doi:10.1090/S0025-5718-98-00974-0.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hpcinv.mesh.source import Floats
from hpcinv.solver.methods.method import Guess

MOST_BYTES = 256_000_000
"""largest size of the solutions that each rank keeps"""
_LARGEST_WEIGHTS = 4.0  # Σ |c_i|: growth of the neighbours' errors; 1 in an interpolation
_ROUNDING = 1e-12
"""Relative difference of numbers that is a rounding error, as in moduli that follow from others. With a smaller one,
cases seem to differ in such moduli; with a larger one, close cases seem equal."""


def is_equal(a: Floats, b: Floats) -> npt.NDArray[np.bool_]:
    """Return which numbers are equal but for rounding errors."""
    return np.asarray(np.abs(a - b) <= _ROUNDING * np.maximum(np.abs(a), np.abs(b)))


class ParameterSpace:
    """Space of the numbers of the cases of one reuse group, scaled so that distances are comparable.

    Numbers of one sign that span more than a factor of 10 are replaced by their logarithm; each is scaled by its
    range. Numbers that do not vary are left out.
    """

    def __init__(self, numbers: Sequence[Sequence[float]] | Floats) -> None:
        values = np.array(numbers, dtype=np.float64).reshape(len(numbers), -1)
        low, high = values.min(axis=0), values.max(axis=0)
        self._varies = np.asarray(~is_equal(low, high))
        low, high = low[self._varies], high[self._varies]
        with np.errstate(divide="ignore", invalid="ignore"):
            self._logarithmic = ((low > 0) & (high > 10 * low)) | ((high < 0) & (low < 10 * high))
        ends = self._transformed(np.stack([low, high]))
        self._origin, self._range = ends.min(axis=0), np.ptp(ends, axis=0)

    def point(self, numbers: Sequence[float] | Floats) -> Floats:
        """Return the point of a case in the unit cube, (dimensions,), or of several, (n, dimensions)."""
        varying = np.array(numbers, dtype=np.float64)[..., self._varies]
        scaled: Floats = (self._transformed(varying) - self._origin) / self._range
        return scaled

    def _transformed(self, values: Floats) -> Floats:
        with np.errstate(divide="ignore"):
            return np.where(self._logarithmic, np.log(np.abs(values)), values)


@dataclass(frozen=True)
class Neighbour:
    """Solution of a converged case: local values on this rank, as in `Guess`."""

    key: str
    point: Floats
    values: Guess

    @property
    def bytes(self) -> int:
        pressure = self.values.pressure
        return self.values.displacement.nbytes + (0 if pressure is None else pressure.nbytes)


class Neighbours:
    """Solutions of the cases of one reuse group that this group of ranks has solved, the same cases on all ranks."""

    def __init__(self) -> None:
        self._neighbours: list[Neighbour] = []

    def __len__(self) -> int:
        return len(self._neighbours)

    def add(self, neighbour: Neighbour, largest: int) -> None:
        """Keep one more solution, and remove the farthest ones if there is no room.

        Args:
            largest: bytes of a solution, the largest over the ranks.
        """
        self._neighbours.append(neighbour)
        while len(self._neighbours) * largest > MOST_BYTES and len(self._neighbours) > 1:
            self._neighbours.pop(int(np.argmax(self._distances(neighbour.point))))

    def guess(self, point: Floats) -> tuple[Guess, str] | None:
        """Return the guess at a point, and the key of the nearest case; ``None`` without neighbours."""
        if not self._neighbours:
            return None
        distances = self._distances(point)
        order = np.argsort(distances, kind="stable")
        nearest = self._neighbours[order[0]]
        # Solutions on the other side of a bifurcation point belong to another branch.
        neighbours = [self._neighbours[i] for i in order if self._neighbours[i].values.sign == nearest.values.sign]
        weights = _weights(np.stack([s.point for s in neighbours]) - point)
        used = [(c, s.values) for c, s in zip(weights, neighbours, strict=False) if c]
        u = sum((c * v.displacement for c, v in used), np.zeros_like(nearest.values.displacement))
        p = None
        if nearest.values.pressure is not None:
            p = sum((c * v.pressure for c, v in used if v.pressure is not None), np.zeros_like(nearest.values.pressure))
        return Guess(u, p, nearest.values.sign), nearest.key

    def _distances(self, point: Floats) -> Floats:
        return np.array([math.dist(s.point, point) for s in self._neighbours])


def _weights(offsets: Floats) -> Floats:
    """Return the weights of neighbours at ``offsets`` (n, dimensions) from the point, the nearest first."""
    n, dimensions = offsets.shape
    nearest_alone: Floats = np.eye(1, n)[0]
    distances = np.linalg.norm(offsets, axis=1)
    if distances[0] == 0.0 or dimensions == 0:
        return nearest_alone
    for degree in (2, 1):
        size = math.comb(dimensions + degree, degree)
        if n < size + 1:
            continue
        count = min(n, 2 * size + 1)
        scale = distances[count - 1]
        P = _monomials(offsets[:count] / scale, degree)
        w = (scale / distances[:count]) ** (degree + 1)
        # min Σ (c_i / w_i)²  with  Pᵀ c = (1, 0, …)
        weighted = P * w[:, None]
        weights = w * np.linalg.lstsq(weighted.T, np.eye(1, P.shape[1])[0], rcond=1e-10)[0]
        reproduced = np.abs(P.T @ weights - np.eye(1, P.shape[1])[0]).max() < 1e-6
        if reproduced and np.abs(weights).sum() <= _LARGEST_WEIGHTS:
            return np.asarray(weights)
    return nearest_alone


def _monomials(points: Floats, degree: int) -> Floats:
    """Return the monomials up to a degree at each point, (n, size); the first is 1."""
    columns = [np.ones(len(points))]
    for k in range(1, degree + 1):
        for which in itertools.combinations_with_replacement(range(points.shape[1]), k):
            columns.append(np.prod(points[:, which], axis=1))
    return np.stack(columns, axis=1)
