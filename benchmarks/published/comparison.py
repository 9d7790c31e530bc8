"""A published value next to ours: difference over the error bars of both."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from .references import PublishedValue

type Verdict = Literal["inside", "outside", "not reliable", "failed", "skipped"]

SAFETY = 1.5
"""Error of our value over the error that its change on a finer mesh has if errors are of first order in the size of the
cells, the lowest order, which singular fibres and supports have. With halved cells an error is three times the change:
the safety factor of Roache (1994, doi:10.1115/1.2910291) for an unknown order. Larger: longer error bars."""

REDISTRIBUTED = 1.02
"""Ratio of sizes below which a mesh has the same cells elsewhere; where these matter, they count as halved."""

ROUNDING = 1e-11
"""Error of our value on a common mesh, relative to it: ten times Newton's tolerance. Larger: a coarser comparison."""


@dataclass(frozen=True)
class ComparedValue:
    """One row of the page, in the unit of the publication.

    Attributes:
        ours, error: value and estimated error; ``nan`` if the run failed.
        inverse: whether the run recovered an unloaded shape.
        reason: why the row is not inside, as the run says; empty if it is.
        missing: whether it was not solved, since the user does not have files of others.
    """

    reference: PublishedValue
    ours: float
    error: float
    unknowns: int
    seconds: float
    reason: str
    missing: bool = False
    inverse: bool = False

    @property
    def difference(self) -> float:
        """Difference in units of the error bar, ours and theirs together."""
        return (self.ours - float(self.reference.value)) / (self.reference.spread + self.error)

    @property
    def verdict(self) -> Verdict:
        if self.missing:
            return "skipped"
        if math.isnan(self.ours):
            return "failed"
        if self.reason:
            return "not reliable"
        return "inside" if abs(self.difference) <= 1 else "outside"


def compare(reference: PublishedValue, summary: Mapping[str, Any]) -> ComparedValue:
    """Return the row of a published value, from the summary of its run."""
    if "missing" in summary:
        return ComparedValue(reference, math.nan, math.nan, 0, math.nan, summary["missing"], missing=True)
    if "failure" in summary:
        return ComparedValue(reference, math.nan, math.nan, 0, math.nan, summary["failure"])
    name, component = re.fullmatch(r"([^\[]+)(?:\[(\d)\])?", reference.quantity).groups()  # type: ignore[union-attr]
    ours = _number(summary["quantities"].get(name), component)
    error, reason = _error(reference, summary, name, component)
    unknowns, seconds = summary["mesh"]["unknowns"], summary["timings"]["total"]
    if math.isnan(ours):
        reason = f"the job has no quantity {reference.quantity}"
    inverse = summary["job"]["analysis"] == "inverse"
    values = ours / reference.factor, error / reference.factor
    return ComparedValue(reference, *values, unknowns, seconds, reason, inverse=inverse)


def _error(
    reference: PublishedValue, summary: Mapping[str, Any], name: str, component: str | None
) -> tuple[float, str]:
    """Return our error (SI), and why it is not known, or empty."""
    ours = abs(_number(summary["quantities"].get(name), component))
    if reference.comparison == "mesh":
        return ROUNDING * ours, ""
    if finer := summary.get("finer"):
        value = _number(summary["quantities"].get(name), component)
        dimension = 2 if summary["job"].get("mesh", {}).get("shell") else 3
        changes = [
            abs(_number(mesh["quantities"].get(name), component) - value)
            * _error_by_change((mesh["mesh"]["unknowns"] / summary["mesh"]["unknowns"]) ** (1 / dimension))
            for mesh in finer
        ]
        return max(changes), ""
    if accuracy := summary.get("accuracy"):
        return abs(accuracy["bounds"][name]), ""
    estimate = summary["certificate"].get("estimate") or {}
    if name not in estimate.get("quantities", {}):
        return math.nan, "the run has no estimate of this quantity"
    singular = estimate.get("singular")
    reason = ""
    if singular and not singular["reliable"]:
        reason = "our estimate is not reliable here: errors may cancel at a singular edge"
    elif name in estimate.get("unreliable", ()):
        reason = "our estimate is not reliable here: the fibres have no limit at this point"
    return abs(_number(estimate["quantities"][name], component)), reason


def _error_by_change(ratio: float) -> float:
    """Return error over change of a value on a mesh of ``ratio`` times smaller cells."""
    ratio = 2.0 if ratio < REDISTRIBUTED else ratio
    return SAFETY * ratio / (ratio - 1)


def _number(value: Any, component: str | None) -> float:
    if isinstance(value, list):
        value = value[int(component or 0)]
    return math.nan if value is None else float(value)
