"""Picture of a result: the given body next to the computed one, coloured by a field."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hpcinv.errors import OutputError
from hpcinv.pictures.boundary_surface import Boundary, BoundaryResult
from hpcinv.pictures.colours import Colour
from hpcinv.pictures.drawing import DrawnBody, Picture, View, directions, figure
from hpcinv.quantity.arrays import Floats
from hpcinv.quantity.stress_measures import COMPONENTS, MEASURES, components_of


def measure(name: str, result: BoundaryResult) -> Floats:
    """Return a stress measure of each triangle, in Pa."""
    stress = result.stress.reshape(-1, 3, 3)
    return np.asarray(MEASURES[name](*(stress[:, *COMPONENTS[component]] for component in components_of(name))))


FIELDS: dict[Colour, tuple[str, Callable[[Boundary, BoundaryResult], Floats | None]]] = {
    "displacement": ("displacement (m)", lambda _, result: np.linalg.norm(result.displacement, axis=1)),
    "von-mises": ("von Mises stress (Pa), mean of each cell", lambda _, result: measure("von_mises", result)),
    "pressure": ("pressure -tr σ/3 (Pa), mean of each cell", lambda _, result: measure("p", result)),
    "J": ("volume ratio J, mean of each cell", lambda _, result: result.J),
    "error": ("estimated error of the displacement gradient", lambda boundary, _: boundary.error),
}
"""Label of each field, and its values on the triangles or at the points."""


def draw_result(summary: Mapping[str, Any], boundary: Boundary, colour: Colour = "displacement") -> Picture:
    """Draw the given body next to the computed ones, in one frame; behind each there is another one as a shadow.

    A body without load shows the values of the result that it belongs to, at the same material points.

    Args:
        summary: content of ``summary.json``.

    Raises:
        OutputError: the run has no values of this colour.
    """
    (label, evaluate), job = FIELDS[colour], summary["job"]
    rest = next((name for name, state in summary.get("states", {}).items() if state["rest"]), "")
    titles, points, results = zip(*_shapes(boundary, rest), strict=True)
    values = [evaluate(boundary, result) for result in results]
    known = [colouring for colouring in values if colouring is not None]
    if len(known) < len(values):
        raise OutputError(
            f"{job['job']}: the run has no values for the colour '{colour}'",
            "Run it with certificate.estimate: true, or choose another colour.",
        )
    frame = np.concatenate(points)
    front, _, up = directions(frame, upwards(job))
    views = []
    for i, shape_values in enumerate(known):
        shadow = DrawnBody(points[0 if i else 1], boundary.triangles, opacity=0.35)
        body = DrawnBody(points[i], boundary.triangles, values=shape_values)
        views.append(View([body, shadow], frame, front, up, titles[i]))
    status, verdict = summary["status"], summary["certificate"]["verdict"]
    notes = f"certificate: {verdict}" if status == "converged" else f"the full load was not reached: {status}"
    limits = min(float(colouring.min()) for colouring in known), max(float(colouring.max()) for colouring in known)
    return figure(views, job["job"], notes=notes, colours=(label, *limits))


def _shapes(boundary: Boundary, rest: str) -> list[tuple[str, Floats, BoundaryResult]]:
    """The given body, the one that the first solve found, and the bodies of further states.

    Returns:
        Of each its title, its points, and the result whose values it shows.
    """
    first, *further = boundary.results
    names = ("undeformed", "deformed") if not first.state else (rest, first.state)
    given, computed = names if first.direction == "forward" else names[::-1]
    return [
        (f"{given}, given", first.mesh, first),
        (f"{computed}, found", first.others, first),
        *((f"{result.state}, found", result.others, result) for result in further),
    ]


def upwards(job: Mapping[str, Any]) -> Floats | None:
    """Direction against gravity, ``None`` without gravity."""
    states = job.get("states") or ()
    effects = [*job.get("effects", ()), *(effect for state in states for effect in state.get("effects") or ())]
    fall = next((effect["acceleration"] for effect in effects if "acceleration" in effect), None)
    return -np.array(fall, dtype=float) if fall and any(fall) else None
