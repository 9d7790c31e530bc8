"""Picture of a result: the given body next to the computed one, coloured by a field."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import cycle
from typing import Any

import numpy as np
import numpy.typing as npt

from hpcinv.base.quantity.arrays import Floats
from hpcinv.base.quantity.stress_measures import COMPONENTS, MEASURES, components_of
from hpcinv.base.quantity.written_units import as_shown, unit_of
from hpcinv.errors import OutputError
from hpcinv.output.surfaces.boundary_surface import Boundary, BoundaryResult
from hpcinv.output.surfaces.picture import REGIONS, Colour, Picture
from hpcinv.pages.pictures.body_section import BodySection, Cut, PictureBody
from hpcinv.pages.pictures.drawing import DrawnBody, View, directions, figure


def measure(name: str, result: BoundaryResult) -> Floats:
    """Return a stress measure of each triangle, in Pa."""
    stress = result.stress.reshape(-1, 3, 3)
    return np.asarray(MEASURES[name](*(stress[:, *COMPONENTS[component]] for component in components_of(name))))


_PLACE = ", mean of each cell"  # of stresses in solids

FIELDS: dict[Colour, tuple[str, str, Callable[[Boundary, BoundaryResult], Floats | None]]] = {
    "displacement": ("displacement", "m", lambda _, result: np.linalg.norm(result.displacement, axis=1)),
    "von-mises": ("von Mises stress" + _PLACE, "Pa", lambda _, result: measure("von_mises", result)),
    "pressure": ("pressure -tr σ/3" + _PLACE, "Pa", lambda _, result: measure("p", result)),
    "J": ("volume ratio J" + _PLACE, "", lambda _, result: result.J),
    "error": ("estimated error of the displacement gradient", "", lambda boundary, _: boundary.error),
    "regions": ("", "", lambda _, result: np.zeros(len(result.J))),
}
"""Label and SI unit of each field, and its values on the triangles or at the points."""


def draw_result(
    summary: Mapping[str, Any], boundary: Boundary, colour: Colour = "displacement", cut: Cut | None = None
) -> Picture:
    """Draw the given body next to the computed ones, in one frame; behind each there is another one as a shadow.

    A body without load shows the values of the result that it belongs to, at the same material points.

    Stresses of a shell are drawn on its two sides.

    Args:
        summary: content of ``summary.json``.
        cut: where the bodies are cut; left out, they are whole.

    Raises:
        OutputError: the run has no values of this colour.
    """
    (label, unit, _), job = FIELDS[colour], summary["job"]
    rest = next((name for name, state in summary.get("states", {}).items() if state["rest"]), "")
    shapes = _shapes(boundary, rest)
    sections = [cut.section(shape) if cut else None for shape in shapes]
    known, inner = _values(job["job"], boundary, shapes, sections, colour)
    lowest, highest = _range([values for values in (*known, *inner) if values is not None])
    units: Mapping[str, str] = summary.get("units") or {}
    size, symbol = unit_of([lowest, highest], unit, units)
    frame = np.concatenate([shape.points for shape in shapes])
    front, back, up = directions(frame, upwards(job))
    views = []
    for i, (shape, section) in enumerate(zip(shapes, sections, strict=True)):
        if colour == "regions":
            parts = [*_coloured_regions(boundary, shape, cut, section, front)]
        else:
            parts = [*_coloured_values(boundary, shape, section, front, known[i], inner[i], size)]
        if section is not None:
            views.append(View(parts, frame, front, up, f"{shape.title}, {_plane_text(section, units)}"))
            continue
        shadow = DrawnBody(shapes[0 if i else 1].points, boundary.triangles, opacity=0.35)
        views.append(View([*parts, shadow], frame, front, up, shape.title))
        if boundary.faces and label.endswith(_PLACE):
            views.append(View(parts, frame, back, up, f"{shape.title}, from behind"))
    draw = partial(figure, views, job["job"], notes=_verdict_text(summary), units=units)
    if colour == "regions":
        return draw(legend=list(_palette(boundary, cut).items()))
    return draw(colours=(_title_of_colours(label, symbol, boundary, cut), lowest / size, highest / size))


def _range(parts: Sequence[Floats]) -> tuple[float, float]:
    """Return the least and the largest value."""
    return min(float(part.min(initial=np.inf)) for part in parts), max(
        float(part.max(initial=-np.inf)) for part in parts
    )


def _verdict_text(summary: Mapping[str, Any]) -> str:
    status, verdict = summary["status"], summary["certificate"]["verdict"]
    return f"certificate: {verdict}" if status == "converged" else f"the full load was not reached: {status}"


def _title_of_colours(label: str, symbol: str, boundary: Boundary, cut: Cut | None) -> str:
    if boundary.faces:
        label = label.replace(_PLACE, " at the faces" + (" and within" if cut else ""))
    return f"{label} ({symbol})" if symbol else label


def _values(
    name: str,
    boundary: Boundary,
    shapes: Sequence[PictureBody],
    sections: Sequence[BodySection | None],
    colour: Colour,
) -> tuple[list[Floats], list[Floats | None]]:
    """Return the values of a colour on the boundary of each body, and in its section."""
    evaluate, lack = FIELDS[colour][2], f"{name}: the run has no values for the colour '{colour}'"
    known = [values for shape in shapes if (values := evaluate(boundary, shape.result)) is not None]
    if len(known) < len(shapes):
        advice = "Run it with certificate.estimate: true, or choose another colour."
        raise OutputError(lack, advice)
    if colour == "error" and any(section is not None for section in sections):
        raise OutputError(f"{lack} within the body", "Choose another colour.")
    return known, [None if section is None else evaluate(boundary, section.values) for section in sections]


def _plane_text(section: BodySection, units: Mapping[str, str]) -> str:
    """Return the plane of a section, such as ``z = 30 mm``."""
    return f"{'xyz'[int(np.argmax(section.normal))]} = {as_shown(section.place, 'm', units, 3)}"


def _palette(boundary: Boundary, cut: Cut | None) -> dict[str, str]:
    """Colour of each region that is seen."""
    names = [name for name, mask in boundary.regions.items() if mask.any()]
    names += [name for name in (cut.interior.regions if cut else ()) if name not in names]
    return dict(zip(names, cycle(REGIONS), strict=False))


def _coloured_values(
    boundary: Boundary,
    shape: PictureBody,
    section: BodySection | None,
    front: Floats,
    values: Floats,
    inner: Floats | None,
    size: float,
) -> Iterator[DrawnBody]:
    """Yield the parts of a body in the colours of values on its boundary, and inside, in units of ``size``."""
    plane = None if section is None else section.plane(front)
    yield DrawnBody(shape.points, boundary.triangles, values=values / size, cut=plane)
    if section is not None:
        spread = section.spread(inner) / size
        yield DrawnBody(section.points, section.triangles, values=spread, is_section=True)


def _coloured_regions(
    boundary: Boundary,
    shape: PictureBody,
    cut: Cut | None,
    section: BodySection | None,
    front: Floats,
) -> Iterator[DrawnBody]:
    """Yield the parts of a body in the colours of its regions; of those that overlap the last is on top."""
    plane = None if section is None else section.plane(front)
    masks: Mapping[str, npt.NDArray[np.bool_]] = boundary.regions
    pieces = [(shape.points, boundary.triangles, masks, plane, False)]
    if cut is not None and section is not None:
        inner: Mapping[str, npt.NDArray[np.bool_]] = {n: mask[section.rows] for n, mask in cut.interior.regions.items()}
        pieces.append((section.points, section.triangles, inner, None, True))
    for points, triangles, regions, own_plane, is_section in pieces:
        hidden = np.zeros(len(triangles), dtype=bool)
        for name, colour in reversed(_palette(boundary, cut).items()):
            visible = regions.get(name, hidden) & ~hidden
            hidden |= visible
            if visible.any():
                yield DrawnBody(points, triangles[visible], colour, cut=own_plane, is_section=is_section)
        if not hidden.all():
            yield DrawnBody(points, triangles[~hidden], cut=own_plane, is_section=is_section)


def _shapes(boundary: Boundary, rest: str) -> list[PictureBody]:
    """The given body, the one that the first solve found, and the bodies of further states."""
    first, *further = boundary.results
    names = ("undeformed", "deformed") if not first.state else (rest, first.state)
    given, computed = names if first.direction == "forward" else names[::-1]
    return [
        PictureBody(f"{given}, given", first.mesh, first, 0, is_mesh=True),
        PictureBody(f"{computed}, found", first.others, first, 0, is_mesh=False),
        *(
            PictureBody(f"{result.state}, found", result.others, result, number, is_mesh=False)
            for number, result in enumerate(further, 1)
        ),
    ]


def upwards(job: Mapping[str, Any]) -> Floats | None:
    """Direction against gravity, ``None`` without gravity."""
    states = job.get("states") or ()
    effects = [*job.get("effects", ()), *(effect for state in states for effect in state.get("effects") or ())]
    fall = next((effect["acceleration"] for effect in effects if "acceleration" in effect), None)
    return -np.array(fall, dtype=float) if fall and any(fall) else None
