"""Convergence under mesh refinement: observed orders and Richardson's extrapolation."""

import itertools
import math
import statistics
from collections.abc import Sequence

from scipy.optimize import brentq

_ORDERS = 0.1, 50.0  # beyond these bounds there is no convergence, or only rounding error


def orders(sizes: Sequence[float], errors: Sequence[float | None]) -> list[float | None]:
    """Return the observed order ``ln(e₁/e₂) / ln(h₁/h₂)`` of each run and the one before it; ``None`` if undefined."""
    pairs = itertools.pairwise(zip(sizes, errors, strict=True))
    values = [math.log(e1 / e2) / math.log(h1 / h2) if e1 and e2 and h1 != h2 else None for (h1, e1), (h2, e2) in pairs]
    return [None, *values]


def fitted_order(sizes: Sequence[float], errors: Sequence[float | None]) -> float | None:
    """Return the slope of the least-squares line through ``(ln h, ln e)``; ``None`` with fewer than two sizes."""
    points = [(math.log(h), math.log(e)) for h, e in zip(sizes, errors, strict=True) if e]
    if len({x for x, _ in points}) < 2:
        return None
    return statistics.linear_regression(*zip(*points, strict=True)).slope


def richardson(sizes: Sequence[float], values: Sequence[float]) -> tuple[float, float]:
    """Return limit ``v`` and order ``p`` of ``v(h) = v + C hᵖ`` through three values on meshes from coarse to fine.

    The order solves ``(h₂ᵖ - h₃ᵖ) / (h₁ᵖ - h₂ᵖ) = (v₃ - v₂) / (v₂ - v₁)``, whose left side decreases with p.

    Raises:
        ValueError: the values are not monotone, or their differences do not shrink as in a convergent series.

    Source: Celik et al., *Procedure for estimation and reporting of uncertainty due to discretization in CFD
    applications* (2008), doi:10.1115/1.2960953.
    """
    (h1, h2, h3), (v1, v2, v3) = sizes, values
    first, second = v2 - v1, v3 - v2
    if first * second <= 0:
        raise ValueError("are not monotone")
    share, (low, high) = second / first, _ORDERS

    def left_side(p: float) -> float:
        return float((h2**p - h3**p) / (h1**p - h2**p))

    if left_side(low) < share:
        raise ValueError("do not come closer to each other as the mesh is refined")
    if left_side(high) > share:
        raise ValueError("have converged too far to show an order")
    order = brentq(lambda p: left_side(p) - share, low, high, xtol=1e-15)
    return float(v3 + second * h3**order / (h2**order - h3**order)), order
