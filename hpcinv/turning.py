"""Turning points of the load on a path of equilibria: where ``dλ/ds`` vanishes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hpcinv.vectors import dot, norm

if TYPE_CHECKING:
    from petsc4py import PETSc

    from hpcinv.bordering import Bordering, Corrected


@dataclass(frozen=True)
class Sample:
    """A point of the path: its distance along a direction, its load, and ``dλ/ds`` along that, if it is known."""

    x: PETSc.Vec
    s: float
    load: float
    slope: float | None


def locate(
    bordering: Bordering, t: PETSc.Vec, low: Sample, high: Sample, *, direction: int, tolerance: float = 1e-3
) -> tuple[Corrected, int]:
    """The turning point between two points of the path, and the factorizations that it took.

    Each trial is a point of the path in a plane normal to ``t``; there ``dλ/ds = 1/t·g`` (see `bordering`). The secant
    method finds its root, kept between the two points.

    Args:
        t: unit vector along which both points were reached.
        low: the point before it, with its slope.
        high: the point after it.
        direction: 1 where the load has a maximum, -1 where it has a minimum.
        tolerance: of the state, relative to its norm.
    """
    scale = max(abs(low.load), abs(high.load))
    last, spent = low, 0
    s = stationary(low, high)
    while True:
        share = (s - low.s) / (high.s - low.s)
        guess = low.x.copy()
        guess.scale(1 - share)
        guess.axpy(share, high.x)
        load = (1 - share) * low.load + share * high.load
        found = bordering.correct(guess, load, t, _TOLERANCE, direction=direction, scale=scale)
        guess.destroy()
        spent += found.factorizations
        if not found.outcome.accepted:
            return found, spent
        spent += 1
        tangent = bordering.tangent(found.x, found.load, t)
        if tangent is None:  # nothing is more singular than the turning point itself
            return found, spent
        slope = tangent.slope / dot(t, tangent.direction)
        sample = Sample(found.x, s, found.load, slope)
        if abs(s - last.s) <= tolerance * norm(found.x) or spent > _ENOUGH:
            return found, spent
        rises = slope * direction > 0
        trial = _secant(last, sample) if last.slope is not None else None
        low, high = (sample, high) if rises else (low, sample)
        if trial is None or not low.s < trial < high.s:
            trial = stationary(low, high)
        last, s = sample, trial


_TOLERANCE = 1e-6
_ENOUGH = 40


def stationary(low: Sample, high: Sample) -> float:
    """Where the slope vanishes between two points: from both slopes, or from the lower one and both loads."""
    width = high.s - low.s
    assert low.slope is not None
    if high.slope is not None:
        share = low.slope / (low.slope - high.slope)
    else:
        share = low.slope * width / (2 * (low.slope * width - (high.load - low.load)))
    return low.s + width * min(max(share, 0.05), 0.95)


def _secant(one: Sample, other: Sample) -> float | None:
    if one.slope is None or other.slope is None or one.slope == other.slope:
        return None
    return other.s - other.slope * (other.s - one.s) / (other.slope - one.slope)
