"""Location of limit points on a path of equilibria, where ``dλ/ds`` vanishes."""

import math
from dataclasses import dataclass

from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import dot, norm
from hpcinv.solver.bordering import BorderedTangent, Bordering, Corrected


@dataclass(frozen=True)
class PathSample:
    """A point of the path: state, distance ``s`` along a direction, load factor, and ``dλ/ds``."""

    x: PETSc.Vec
    s: float
    load: float
    slope: float


def locate(
    bordering: Bordering, t: PETSc.Vec, low: PathSample, high: PathSample, *, direction: int
) -> tuple[Corrected, BorderedTangent | None, int]:
    """Return the limit point between two points of the path, the tangent there, and the number of factorizations.

    Each trial is a point of the path in a plane normal to ``t``, where ``dλ/ds = 1/t·g`` (see `bordering`). The root is
    found by the secant method, bounded by the two points. The tangent is ``None`` if its factorization failed.

    Args:
        t: unit vector along which both points were reached.
        direction: 1 for a maximum of the load, -1 for a minimum.
    """
    scale = max(abs(low.load), abs(high.load))
    last, spent = low, 0
    s = _bounded_root(low, high)
    while True:
        share = (s - low.s) / (high.s - low.s)
        guess = low.x.copy()
        guess.scale(1 - share)
        guess.axpy(share, high.x)
        load = (1 - share) * low.load + share * high.load
        corrected = bordering.correct(guess, load, t, _TOLERANCE, direction=direction, scale=scale)
        guess.destroy()
        spent += corrected.solve.factorizations
        if not corrected.solve.outcome.accepted:
            return corrected, None, spent
        spent += 1
        tangent = bordering.tangent(corrected.x, corrected.solve.load, t)
        if tangent is None:  # the tangent is singular at the limit point
            return corrected, None, spent
        slope = tangent.slope / dot(t, tangent.direction)
        sample = PathSample(corrected.x, s, corrected.solve.load, slope)
        if abs(s - last.s) <= _STATE_TOLERANCE * norm(corrected.x) or spent > _MOST_FACTORIZATIONS:
            return corrected, tangent, spent
        rises = slope * direction > 0
        trial = _secant(last, sample)
        low, high = (sample, high) if rises else (low, sample)
        last, s = sample, trial if low.s < trial < high.s else _bounded_root(low, high)


_STATE_TOLERANCE = 1e-3  # change of the state between trials, relative to its norm
_TOLERANCE = 1e-8  # of the points
_MOST_FACTORIZATIONS = 40


def _secant(first: PathSample, second: PathSample) -> float:
    return second.s - second.slope * (second.s - first.s) / ((second.slope - first.slope) or math.inf)


def _bounded_root(low: PathSample, high: PathSample) -> float:
    """Return the root as `_secant`, limited to the middle nine tenths of the interval."""
    share = (_secant(low, high) - low.s) / (high.s - low.s)
    return low.s + (high.s - low.s) * min(max(share, 0.05), 0.95)
