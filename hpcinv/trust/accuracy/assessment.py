"""Estimated errors of the quantities of interest, from all discretisations that were solved.

The error estimate compares one degree with the next on the same mesh. It does not contain errors that a finer mesh
alone reveals, such as the geometry of a curved body or a maximum between nodes; these are estimated by the difference
of the corrected values on two meshes. The estimate itself is tested: the one of a discretisation is compared with the
values of the next one, and no error is promised that is smaller than the last change of the value allows. With a ratio
r of successive errors, a change Δ leaves ``Δ r/(1 - r)``; r is not less than the ratio of the estimates, and than
singular edges allow. Where the next mesh does not confirm an estimate, or one mesh proves nothing, r is not less than
the last two changes show.

Where singular edges have a share of the error, or volumes are not explained by the pressure, one mesh proves nothing,
and no error is promised that is smaller than the last change between two meshes.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from hpcinv.job.quantity_of_interest import QuantityValue

UNTESTED, LEAST, MOST = 2.0, 1.5, 10.0  # safety factors: of an untested estimate, and their bounds
FASTEST = 4.0  # largest presumed order of the errors that the estimate does not contain
LOWEST = 0.5  # least order of errors that changes of a value are taken for; the end of a support within a face has 1
SLOWEST = 0.75  # largest presumed ratio of these errors on a finer mesh to those on a coarser one
NEARLY_EQUAL = 0.9
"""Largest presumed ratio of successive errors whose values changed; raised, small steps promise less."""
CONFIRMED = 1.5
"""Factor within which the next mesh must confirm an error that was estimated; raised, the rate at which estimates fall
is trusted more often, and the rate of the changes counts less often."""
DOUBTED = 1.5
"""Safety factor of what a change of the value leaves, where one mesh proves nothing; raised, searches take longer."""


@dataclass(frozen=True)
class Finding:
    """Values of one discretisation.

    Attributes:
        size: of the cells, as in `forecast.Step`.
        corrected: these values plus the estimated errors.
        ratio: least ratio of its errors to the errors of the finding before, by singular edges; 0 if nothing is known.
        is_reliable: whether its estimate is, by itself.
        needs_test: whether its estimate must be compared with another mesh: singular edges or unexplained volumes.
    """

    mesh: int
    size: float | None
    degree: int
    values: Mapping[str, QuantityValue]
    corrected: Mapping[str, QuantityValue]
    ratio: float = 0.0
    is_reliable: bool = True
    needs_test: bool = False

    @property
    def is_proof(self) -> bool:
        """True if its estimate may end a search without another discretisation."""
        return self.is_reliable and not self.needs_test


@dataclass(frozen=True)
class Assessment:
    """Estimated errors of the last finding.

    Attributes:
        safety: factors by which the errors are multiplied before they are compared with the demands.
        demands: largest errors that the job allows.
        least: smallest errors that the last change of the values allows.
        layer: errors that the layer of a shell leaves on any mesh.
        certain: errors that are there unless a richer discretisation is less accurate.
    """

    errors: Mapping[str, float]
    safety: Mapping[str, float]
    demands: Mapping[str, float]
    least: Mapping[str, float] = field(default_factory=dict)
    layer: Mapping[str, float] = field(default_factory=dict)
    certain: Mapping[str, float] = field(default_factory=dict)

    @property
    def bounds(self) -> dict[str, float]:
        """Bounds of the errors: each error times its safety factor, or its least value, plus the error of layers."""
        return {
            name: max(self.safety[name] * e, self.least.get(name, 0.0)) + self.layer.get(name, 0.0)
            for name, e in self.errors.items()
        }

    @property
    def layer_excess(self) -> float:
        """The largest ratio of a layer's error to its demand."""
        return max((error / self.demands[name] for name, error in self.layer.items()), default=0.0)

    @property
    def excess(self) -> float:
        """The largest ratio of a bound to its demand; the demands are met if it is at most 1."""
        return max(bound / self.demands[name] for name, bound in self.bounds.items())


def assess(
    findings: Sequence[Finding],
    demands: Mapping[str, float],
    unseen_order: float | None,
    previous: Assessment | None = None,
    layer: Mapping[str, float] = MappingProxyType({}),
) -> Assessment:
    """Assess the last of the ``findings``.

    Args:
        previous: assessment of the last but one.
        unseen_order: order of the errors that an estimate on one mesh does not contain; ``None`` if there are none.
        layer: as in `Assessment`.
    """
    errors, safety, least, certain = {}, {}, {}, {}
    for name, demand in demands.items():
        last = findings[-1]
        errors[name] = distance(last.corrected[name], last.values[name]) + _unseen(findings, name, unseen_order)
        safety[name] = _safety(findings, name, demand, previous)
        least[name] = _least(findings, name, previous)
        certain[name] = _certain(findings, name)
    return Assessment(errors, safety, demands, least, layer, certain)


def hindsight(findings: Sequence[Finding], demands: Mapping[str, float]) -> list[float]:
    """Return the error of each finding against the best values known now: the largest ratio to a demand."""
    best = findings[-1].corrected
    return [max(distance(f.values[name], best[name]) / demand for name, demand in demands.items()) for f in findings]


def _unseen(findings: Sequence[Finding], name: str, order: float | None) -> float:
    """Return the part of the last difference between corrected values on two meshes that is presumed to remain."""
    pairs = [(f, g) for f, g in itertools.pairwise(findings) if f.mesh != g.mesh]
    if not pairs:
        return 0.0 if order is None else math.inf
    earlier, later = pairs[-1]
    if order is None and later is not findings[-1]:
        return 0.0  # a higher degree on the same mesh improves the corrected values, too
    differences = [distance(g.corrected[name], f.corrected[name]) for f, g in pairs]
    sizes = [f.size for f, _ in pairs] + [later.size]
    if sizes[-2] is None or sizes[-1] is None:  # refined locally
        expected, actual = (distance(f.corrected[name], f.values[name]) for f in (earlier, later))
        left = max(actual / expected, 0.25) if expected > 0 else SLOWEST
    else:
        power = later.degree + 1.0 if order is None else order
        if len(pairs) > 1 and sizes[-3] is not None:
            seen = _order_seen((sizes[-3], sizes[-2], sizes[-1]), differences[-2], differences[-1])
            power = max(seen, power)
        left = (sizes[-1] / sizes[-2]) ** power
    left = min(max(left, later.ratio), SLOWEST)
    return differences[-1] * left / (1 - left)


def _least(findings: Sequence[Finding], name: str, previous: Assessment | None) -> float:
    """Return the error that the last changes of a value allow; infinite for one estimate that proves nothing."""
    last = findings[-1]
    if previous is None or len(findings) < 2:
        return 0.0 if last.is_proof else math.inf
    earlier, later = (distance(f.corrected[name], f.values[name]) for f in findings[-2:])
    before = findings[-2].values[name]
    ratio = max(later / earlier if earlier > 0 else 0.0, last.ratio)
    if last.needs_test or not earlier / CONFIRMED <= distance(last.corrected[name], before) <= CONFIRMED * earlier:
        ratio = max(ratio, _ratio_of_changes(findings, name))
    ratio = min(ratio, NEARLY_EQUAL)
    least = distance(last.values[name], before) * ratio / (1 - ratio)
    if last.needs_test:
        other = next((f for f in reversed(findings) if f.mesh != last.mesh), None)
        if other is None:
            return math.inf
        least = max(DOUBTED * least, distance(last.values[name], other.values[name]))
    # A small change may be an accident where errors nearly cancel.
    known = previous.least.get(name, 0.0)
    return least if last.is_reliable or not math.isfinite(known) else max(least, last.ratio * known)


def _certain(findings: Sequence[Finding], name: str) -> float:
    """Return half the estimate, or less where the estimate before was too large.

    A corrected value that is at least as accurate is not farther from the value than twice its error.
    """
    *_, last = findings
    half = distance(last.corrected[name], last.values[name]) / 2
    if len(findings) < 2:
        return half
    earlier = findings[-2]
    estimated, actual = (distance(f.corrected[name], earlier.values[name]) for f in (earlier, last))
    return half * min(1.0, actual / estimated) if estimated > 0 else half


def _ratio_of_changes(findings: Sequence[Finding], name: str) -> float:
    """Return the ratio of the last two errors by the last two changes of a value, 0 with fewer."""
    if len(findings) < 3:
        return 0.0
    first, second, third = findings[-3:]
    changes = [distance(g.values[name], f.values[name]) for f, g in ((first, second), (second, third))]
    if first.size is None or second.size is None or third.size is None:
        return min(changes[1] / changes[0], SLOWEST) if changes[0] > 0 else SLOWEST
    if third.degree > first.degree and not third.needs_test:
        return 0.0
    # At singular edges, errors depend on the size over the square of the degree.
    coarse, middle, fine = (
        size / f.degree**2 for size, f in zip((first.size, second.size, third.size), findings[-3:], strict=True)
    )
    if not coarse > middle > fine:
        return 0.0
    return float((fine / middle) ** max(_order_seen((coarse, middle, fine), *changes), LOWEST))


def _order_seen(sizes: tuple[float, float, float], earlier: float, later: float) -> float:
    """Return ``k`` of errors ``h^k`` that differ by ``earlier`` and ``later`` on successive meshes."""
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
    """Return the safety factor: larger, the more the last error but one was underestimated, as known now."""
    if previous is None or not math.isfinite(estimated := previous.errors[name]):
        return UNTESTED
    earlier, later = findings[-2:]
    lowest = UNTESTED if later.needs_test else LEAST
    actual = distance(later.corrected[name], earlier.values[name])
    if max(estimated, actual) < 0.01 * demand:
        return UNTESTED
    return min(max(lowest, LEAST * actual / estimated), MOST) if estimated > 0 else MOST


def distance(first: QuantityValue, second: QuantityValue) -> float:
    """Return the distance of two numbers or vectors."""
    return float(np.linalg.norm(np.subtract(first, second)))
