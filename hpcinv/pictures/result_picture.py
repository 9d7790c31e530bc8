"""Picture of a result: the given body beside the one that was found, coloured by a field."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from hpcinv.errors import OutputError
from hpcinv.mesh.source import Floats
from hpcinv.pictures.boundary import Boundary
from hpcinv.pictures.drawing import Body, Picture, View, directions, figure

type Colour = Literal["displacement", "von-mises", "pressure", "J", "error"]


@dataclass(frozen=True)
class _Field:
    label: str
    evaluate: Callable[[Boundary], Floats | None]


def _von_mises(boundary: Boundary) -> Floats | None:
    if boundary.stress is None:
        return None
    stress = boundary.stress.reshape(-1, 3, 3)
    deviator = stress - np.trace(stress, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    return np.asarray(np.sqrt(1.5 * np.einsum("tij,tij->t", deviator, deviator)))


def _pressure(boundary: Boundary) -> Floats | None:
    return None if boundary.stress is None else -boundary.stress[:, [0, 4, 8]].mean(axis=1)


FIELDS: dict[str, _Field] = {
    "displacement": _Field("displacement (m)", lambda b: np.linalg.norm(b.displacement, axis=1)),
    "von-mises": _Field("von Mises stress (Pa), mean of each cell", _von_mises),
    "pressure": _Field("pressure -tr σ/3 (Pa), mean of each cell", _pressure),
    "J": _Field("volume ratio J, mean of each cell", lambda b: b.J),
    "error": _Field("estimated error of the displacement gradient", lambda b: b.error),
}
_BODIES = {"forward": ("undeformed, given", "deformed, found"), "inverse": ("deformed, given", "undeformed, found")}


def draw_result(summary: Mapping[str, Any], boundary: Boundary, colour: str = "displacement") -> Picture:
    """Draw the given body beside the one that was found, in one frame; the other one is there as a shadow.

    Args:
        summary: content of ``summary.json``.

    Raises:
        OutputError: the run has no values of this colour.
    """
    field, name = FIELDS[colour], summary["job"]["job"]
    values = field.evaluate(boundary)
    if values is None:
        raise OutputError(f"{name}: the run has no values for the colour '{colour}'", _ADVICE[colour == "error"])
    fall = next((effect["acceleration"] for effect in summary["job"]["effects"] if "acceleration" in effect), None)
    up = -np.array(fall, dtype=float) if fall and any(fall) else None
    front, _, up = directions(np.concatenate([boundary.points, boundary.others]), up)
    shapes = (boundary.points, boundary.others)
    views = [
        View(
            [Body(shape, boundary.triangles, values=values), Body(shadow, boundary.triangles, opacity=0.2)],
            front,
            up,
            title,
        )
        for shape, shadow, title in zip(shapes, shapes[::-1], _BODIES[boundary.direction], strict=True)
    ]
    status = summary["status"]
    notes = f"certificate: {summary['certificate']['verdict']}" if status == "converged" else f"{_STOPPED}: {status}"
    return figure(views, name, notes=notes, colours=(field.label, float(values.min()), float(values.max())))


_ADVICE = ("Choose another colour.", "Run it with certificate.estimate: true, or choose another colour.")
_STOPPED = "the full load was not reached"
