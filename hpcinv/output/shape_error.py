"""The largest known error of a computed shape, and its cause."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hpcinv.base.quantity.units import readable

CAUSES: Mapping[str, str] = {
    "mesh": "the mesh",
    "surface": "the given surface",
    "round trip": "the round trip",
}
"""what a cause is called in sentences"""

REMEDIES: Mapping[str, str] = {
    "mesh": "Refine the mesh, or demand an accuracy, for a better shape.",
    "surface": "Take a better surface, such as from smaller voxels; a finer mesh does not help.",
    "round trip": "Read the line on stability: the return solve may lead to another state.",
}


@dataclass(frozen=True)
class ShapeError:
    """Estimated errors of a shape in m by their cause, the largest first; a surface's error is a standard deviation."""

    causes: Mapping[str, float]

    @property
    def cause(self) -> str:
        return next(iter(self.causes))

    @property
    def largest(self) -> float:
        return self.causes[self.cause]

    @property
    def text(self) -> str:
        """The largest error with its cause, and the others."""
        less = [f"{readable(value, 'm')} from {CAUSES[cause]}" for cause, value in list(self.causes.items())[1:]]
        others = f" ({', '.join(less)})" if less else ""
        return f"{readable(self.largest, 'm')} from {CAUSES[self.cause]}{others}"

    def as_data(self) -> dict[str, Any]:
        """Return JSON data."""
        return {"largest": self.largest, "cause": self.cause, "by_cause": dict(self.causes)}


def _round_trips(lines: Sequence[Mapping[str, Any]], solutions: Sequence[Mapping[str, Any]]) -> list[float]:
    """Return what round trips miss (m)."""
    shares = [float(line["value"]) for line in lines if line["name"].startswith("round trip") and line["value"]]
    return [share * float(solutions[0]["largest_displacement"]) for share in shares if solutions]


def _surface_deviations(surface: Mapping[str, Any]) -> list[float]:
    """Return the known standard deviations (m) of shapes by errors of the given surface."""
    shapes = surface.get("shapes") or {"": surface.get("shape") or {"sd": None}}
    return [float(shape["sd"]) for shape in shapes.values() if shape["sd"] is not None]


def shape_error(summary: Mapping[str, Any]) -> ShapeError | None:
    """Return the errors that a summary has of its shapes, over all states; ``None`` if it has none."""
    certificate, causes = summary["certificate"], dict[str, float]()
    estimate = certificate.get("estimate") or {}
    if estimate.get("shape") is not None:
        causes["mesh"] = float(estimate["shape"])
    if known := _surface_deviations(summary.get("surface_errors") or {}):
        causes["surface"] = max(known)
    gaps = _round_trips(certificate["lines"], summary["solutions"])
    if causes and gaps and max(gaps) > max(causes.values()):
        causes["round trip"] = max(gaps)
    if not causes:
        return None
    return ShapeError(dict(sorted(causes.items(), key=lambda item: -item[1])))
