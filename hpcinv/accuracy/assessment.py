"""How far the quantities of interest may be off, judged by all discretisations that were solved.

The estimate compares one degree with the next on the same mesh. What it cannot see, the shape that a coarse mesh gives
to a curved body, or nodes that happen to lie beside a maximum, is what corrected values on two meshes differ by. The
estimate itself is put to the test: what it foresaw for one discretisation is compared with what the next one found.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

type Value = float | list[float]

UNTESTED, LEAST, MOST = 2.0, 1.5, 10.0  # safety factors: of an estimate not yet put to the test; and their bounds
FASTEST = 4.0  # order with which what an estimate cannot see is believed to fall, at most
SLOWEST = 0.75  # share of the error that is presumed to remain at each step to a finer mesh, at most


@dataclass(frozen=True)
class Finding:
    """What one discretisation found.

    Attributes:
        mesh: number of its mesh.
        size: of the cells, as in `forecast.Step`.
        degree: of the displacement.
        values: of the quantities with a demand.
        corrected: the same, corrected by the estimate.
    """

    mesh: int
    size: float | None
    degree: int
    values: Mapping[str, Value]
    corrected: Mapping[str, Value]


@dataclass(frozen=True)
class Assessment:
    """Estimated errors of the last finding.

    Attributes:
        errors: estimated error of each quantity.
        safety: by which they are multiplied before they are compared with the demands.
        demands: what they may be.
    """

    errors: Mapping[str, float]
    safety: Mapping[str, float]
    demands: Mapping[str, float]

    @property
    def bounds(self) -> dict[str, float]:
        """The errors with their safety factors."""
        return {name: self.safety[name] * error for name, error in self.errors.items()}

    @property
    def excess(self) -> float:
        """The largest bound over its demand: the promise is made if it is at most 1."""
        return max(bound / self.demands[name] for name, bound in self.bounds.items())


def assess(
    findings: Sequence[Finding],
    demands: Mapping[str, float],
    unseen_order: float | None,
    previous: Assessment | None = None,
) -> Assessment:
    """Judge the last of the ``findings``.

    Args:
        previous: what was said of the last but one.
        unseen_order: power of the cells' size with which falls what an estimate on one mesh cannot see; ``None`` where
            there is nothing of that kind.
    """
    errors, safety = {}, {}
    for name, demand in demands.items():
        last = findings[-1]
        errors[name] = distance(last.corrected[name], last.values[name]) + _unseen(findings, name, unseen_order)
        safety[name] = _safety(findings, name, demand, previous)
    return Assessment(errors, safety, demands)


def hindsight(findings: Sequence[Finding], demands: Mapping[str, float]) -> list[float]:
    """How far each finding was from what is best known now: the largest distance over its demand."""
    best = findings[-1].corrected
    return [max(distance(f.values[name], best[name]) / demand for name, demand in demands.items()) for f in findings]


def _unseen(findings: Sequence[Finding], name: str, order: float | None) -> float:
    """What is left of the difference between the corrected values on two meshes."""
    pairs = [(f, g) for f, g in itertools.pairwise(findings) if f.mesh != g.mesh]
    if not pairs:
        return 0.0 if order is None else math.inf
    before, after = pairs[-1]
    if order is None and after is not findings[-1]:
        return 0.0  # a degree more on the same mesh makes the corrected values better too
    differences = [distance(g.corrected[name], f.corrected[name]) for f, g in pairs]
    sizes = [f.size for f, _ in pairs] + [after.size]
    if sizes[-2] is None or sizes[-1] is None:  # refined in places
        foreseen, found = (distance(f.corrected[name], f.values[name]) for f in (before, after))
        left = max(found / foreseen, 0.25) if foreseen > 0 else SLOWEST
    else:
        power = after.degree + 1.0 if order is None else order
        if len(pairs) > 1 and sizes[-3] is not None:
            seen = _order_seen((sizes[-3], sizes[-2], sizes[-1]), differences[-2], differences[-1])
            power = max(seen, power)
        left = (sizes[-1] / sizes[-2]) ** power
    left = min(left, SLOWEST)
    return differences[-1] * left / (1 - left)


def _order_seen(sizes: tuple[float, float, float], earlier: float, later: float) -> float:
    """The ``k`` of errors ``h^k`` that differ by so much on meshes of these ``sizes``, from the first to the last."""
    low, high = 0.0, FASTEST
    for _ in range(40):
        k = (low + high) / 2
        coarse, middle, fine = (size**k for size in sizes)
        if abs(middle - fine) * earlier > later * abs(coarse - middle):
            low = k
        else:
            high = k
    return low


def _safety(findings: Sequence[Finding], name: str, demand: float, previous: Assessment | None) -> float:
    """The larger, the less had been said of the error of the last but one that is known of it now."""
    if previous is None or not math.isfinite(said := previous.errors[name]):
        return UNTESTED
    before, after = findings[-2:]
    found = distance(after.corrected[name], before.values[name])
    if max(said, found) < 0.01 * demand:
        return UNTESTED
    return min(max(LEAST, LEAST * found / said), MOST) if said > 0 else MOST


def distance(one: Value, other: Value) -> float:
    """Of two values: of vectors, the length of their difference."""
    a, b = (v if isinstance(v, list) else [v] for v in (one, other))
    return math.dist(a, b)


def magnitude(value: Value) -> float:
    """Of a number or vector."""
    return math.hypot(*value) if isinstance(value, list) else abs(value)
