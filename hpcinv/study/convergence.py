"""How fast values converge as the mesh is refined, and where to: orders and Richardson's extrapolation."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

_ORDERS = 0.1, 50.0  # what is beyond is no convergence, or rounding error


def orders(sizes: Sequence[float], errors: Sequence[float | None]) -> list[float | None]:
    """Observed order ``ln(e₁/e₂) / ln(h₁/h₂)`` at each run, from the one before it; ``None`` where there is none."""
    pairs = itertools.pairwise(zip(sizes, errors, strict=True))
    found = [math.log(e1 / e2) / math.log(h1 / h2) if e1 and e2 and h1 != h2 else None for (h1, e1), (h2, e2) in pairs]
    return [None, *found]


def fitted_order(sizes: Sequence[float], errors: Sequence[float | None]) -> float | None:
    """Slope of the least-squares line through ``(ln h, ln e)``; ``None`` with fewer than two different sizes."""
    points = [(math.log(h), math.log(e)) for h, e in zip(sizes, errors, strict=True) if e]
    if len({x for x, _ in points}) < 2:
        return None
    mean_x, mean_y = (math.fsum(c) / len(points) for c in zip(*points, strict=True))
    covariance = math.fsum((x - mean_x) * (y - mean_y) for x, y in points)
    return covariance / math.fsum((x - mean_x) ** 2 for x, _ in points)


def richardson(sizes: Sequence[float], values: Sequence[float]) -> tuple[float, float]:
    """Limit ``v`` and order ``p`` of ``v(h) = v + C hᵖ`` through three values on meshes from coarse to fine.

    The order solves ``(h₂ᵖ - h₃ᵖ) / (h₁ᵖ - h₂ᵖ) = (v₃ - v₂) / (v₂ - v₁)``, whose left side falls with p.

    Raises:
        ValueError: the values are not monotone, or their differences do not shrink as those of a convergent series do.

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
        raise ValueError("have converged too far to tell how fast they do")
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if left_side(middle) > share else (low, middle)
    return float(v3 + second * h3**high / (h2**high - h3**high)), high
