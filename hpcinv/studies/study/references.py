"""Reference values of a study: a closed form, the finest run, or Richardson's extrapolation."""

import itertools
import math
import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from scipy.optimize import brentq

from hpcinv.studies.study.result_rows import StudyRow
from hpcinv.studies.study.study_spec import LEAST_MESHES, Reference

_ORDERS = 0.1, 50.0  # beyond these bounds there is no convergence, or only rounding error


@dataclass(frozen=True)
class ReferenceValue:
    """A reference value, its origin, and the key of the run that has it, if it is the value of a run."""

    value: float
    origin: str
    key: str | None = None

    def error_of(self, row: StudyRow, name: str) -> float | None:
        """Return the error of a run's value; ``None`` for the run that is the reference."""
        value = row.values[name]
        return None if value is None or row.key == self.key else abs(value - self.value)


def _candidates(reference: Reference, rows: Sequence[StudyRow], name: str) -> list[StudyRow]:
    """Return the rows whose value of a quantity may be the reference."""
    known = [row for row in rows if row.values[name] is not None and reference.series in (None, row.place.series)]
    if reference.kind != "richardson" or reference.series is not None:
        return known
    counts = Counter(row.place.series for row in known if row.size is not None)  # of the series that refine the mesh
    return [row for row in known if counts[row.place.series] >= LEAST_MESHES] or known


def find_reference(reference: Reference, rows: Sequence[StudyRow], name: str) -> ReferenceValue:
    """Return the reference of one quantity among the rows of one case.

    Raises:
        ValueError: there is none; the message has reason and remedy.
    """
    if reference.value is not None:
        return ReferenceValue(reference.value, reference.kind)
    known = _candidates(reference, rows, name)
    if not known:
        raise ValueError("no run has a value that can be the reference")
    # Of equally fine runs the last one is taken, since a series of tolerances ends with the strictest.
    finest = max(reversed(known), key=lambda row: row.costs["unknowns"] or 0.0)
    if reference.kind == "finest":
        value = finest.values[name]
        assert value is not None
        return ReferenceValue(value, f"finest run: {finest.place.title}", finest.key)
    return _extrapolated([row for row in known if row.place.series == finest.place.series], name)


def _extrapolated(rows: Sequence[StudyRow], name: str) -> ReferenceValue:
    series = rows[0].place.series
    instead = "; take finest or a value instead, or another series: {richardson: NAME}"
    rows_by_size = {row.size: row for row in rows if row.size is not None}
    if len(rows_by_size) == 0:
        raise ValueError(f"richardson needs a series along which nothing but the mesh varies, not '{series}'{instead}")
    three = [rows_by_size[size] for size in sorted(rows_by_size, reverse=True)[-3:]]
    if len(three) < LEAST_MESHES:
        raise ValueError(f"richardson needs three meshes, and series '{series}' has {len(three)}{instead}")
    values = [row.values[name] or 0.0 for row in three]
    try:
        limit, order = richardson([row.size or 0.0 for row in three], values)
    except ValueError as error:
        shown = ", ".join(f"{value:.9g}" for value in values)
        raise ValueError(f"richardson: the values of series '{series}', {shown}, {error}{instead}") from None
    return ReferenceValue(limit, f"Richardson's extrapolation of {series}, observed order {order:.2f}")


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
