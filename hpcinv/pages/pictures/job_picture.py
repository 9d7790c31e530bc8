"""Picture of a job before it runs: the mesh with regions, supports and loads."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from typing import Any

import numpy as np
import yaml
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from hpcinv.base.quantity.arrays import Booleans, Floats
from hpcinv.job.job import Job
from hpcinv.output.surfaces.boundary_surface import Boundary
from hpcinv.output.surfaces.picture import REGIONS, Picture
from hpcinv.pages.pictures.drawing import DrawnBody, Glyphs, View, directions, extent, figure

_BODY = "#d9d9d9"
_SUPPORTS = ("#0072B2", "#56B4E9", "#004466", "#88AACC")
_LOADS = ("#D55E00", "#E69F00", "#CC79A7", "#8B2500")
_FACES = ("#C3DEC9", "#E8DFB0")  # of the outer and the inner face, where they have no support or load
_SYMBOLS = 40  # of one support or load
_SIZE = 0.07  # of an arrow, relative to the body
_TEXT = 90  # characters of a line of the legend


def draw_job(job: Job, boundary: Boundary) -> Picture:
    """Draw the given mesh of a job from two sides, with its supports in blue and its loads in red and yellow.

    A job with states is drawn in the state that is solved first.
    """
    size, kind, given_data = extent(boundary.points), job.kind, job.data
    job = job.plan[0].job
    if job.state:
        given_data = {**given_data, **next(state for state in given_data["states"] if state["name"] == job.state)}
        kind += f", loads of '{job.state}'"
    parts: list[DrawnBody | Glyphs] = []
    legend, marked = [], np.zeros(len(boundary.triangles), dtype=bool)
    up = None
    for support, colour, given in zip(job.supports, cycle(_SUPPORTS), _rows(given_data, "supports"), strict=False):
        mask = boundary.region_mask(support.region)
        legend.append((f"support {_text(given, f'region: {support.region}')}", colour))
        marked |= mask
        parts.append(DrawnBody(boundary.points, boundary.triangles[mask], colour))
        parts.extend(_fixings(boundary, support.region, support.components, colour, size))
    rows = [*_rows(given_data, "effects"), *_unknown_pressures(job)]
    for effect, colour, given in zip(job.effects, cycle(_LOADS), rows, strict=False):
        kept = {name: value for name, value in given.items() if name != "effect"}
        legend.append((_text(kept, effect.effect), colour))  # type: ignore[attr-defined]
        region, vector = getattr(effect, "region", None), _numbers(getattr(effect, "acceleration", None))
        if vector is not None:
            up = -vector
            parts.append(_outer_arrow(boundary.points, vector, colour, size))
        if region is None:
            continue
        mask = boundary.region_mask(region)
        new = mask & ~marked
        marked |= mask
        parts.append(DrawnBody(boundary.points, boundary.triangles[new], colour))
        centres, normals = _sample(boundary, region)
        vector = _numbers(getattr(effect, "traction", getattr(effect, "moment", None)))
        pull = -normals if vector is None else np.broadcast_to(vector / np.linalg.norm(vector), normals.shape)
        parts.append(Glyphs(centres, colour, pull * _SIZE * size))
    for face, colour in zip(boundary.faces, _FACES, strict=False):
        new = boundary.region_mask(face) & ~marked
        marked |= new
        if new.any():
            legend.append((f"{face} face", colour))
            parts.append(DrawnBody(boundary.points, boundary.triangles[new], colour))
    parts.append(DrawnBody(boundary.points, boundary.triangles[~marked], _BODY))
    return _both_sides(f"{job.job}: {kind}", boundary, parts, legend, up)


def draw_mesh(name: str, boundary: Boundary) -> Picture:
    """Draw a mesh from two sides, each named region in a colour; of regions that overlap the last is on top."""
    parts, legend = list[DrawnBody | Glyphs](), list[tuple[str, str]]()
    hidden = np.zeros(len(boundary.triangles), dtype=bool)
    for (region, mask), colour in zip(reversed(list(boundary.regions.items())), cycle(REGIONS), strict=False):
        visible = mask & ~hidden
        covered = "" if visible.any() or not mask.any() else ", covered by those above"
        legend.append((f"{region}: {mask.sum()} triangles of the boundary{covered}", colour))
        if visible.any():
            parts.append(DrawnBody(boundary.points, boundary.triangles[visible], colour))
        hidden |= mask
    parts.append(DrawnBody(boundary.points, boundary.triangles[~hidden], _BODY))
    return _both_sides(name, boundary, parts, legend)


def _both_sides(
    title: str,
    boundary: Boundary,
    parts: Sequence[DrawnBody | Glyphs],
    legend: Sequence[tuple[str, str]],
    up: Floats | None = None,
) -> Picture:
    front, back, up = directions(boundary.points, up)
    tails = [part.points - part.vectors for part in parts if isinstance(part, Glyphs) and part.vectors is not None]
    frame = np.concatenate([boundary.points, *tails])
    views = [
        View(parts, frame, front, up, "from in front, above"),
        View(parts, frame, back, up, "from behind, below"),
    ]
    hollow = _enclosed(boundary)
    if len(hollow):
        views.append(View(_behind(parts, hollow.mean(axis=0), front), frame, front, up, "cut open"))
    return figure(views, title, legend=legend, notes=boundary.size)


def _enclosed(boundary: Boundary) -> Floats:
    """Return the points (n, 3) of closed cavities, whose surface is apart from the outer one."""
    count = len(boundary.points)
    ends = boundary.triangles[:, [0, 1, 1, 2]].reshape(-1, 2)
    links = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    number, parts = connected_components(links, directed=False)
    used = np.unique(boundary.triangles)
    boxes = np.full((number, 2, 3), np.inf)
    boxes[:, 1] = -np.inf
    np.minimum.at(boxes[:, 0], parts[used], boundary.points[used])
    np.maximum.at(boxes[:, 1], parts[used], boundary.points[used])
    low, high = boxes[:, None, 0], boxes[:, None, 1]
    is_within: Booleans = np.asarray((low > boxes[None, :, 0]) & (high < boxes[None, :, 1]))
    is_inside = np.any(np.all(is_within, axis=2), axis=1)
    points: Floats = boundary.points[used[is_inside[parts[used]]]]
    return points


def _behind(parts: Sequence[DrawnBody | Glyphs], place: Floats, direction: Floats) -> list[DrawnBody | Glyphs]:
    """Return what is behind a plane across the axis that a view follows most."""
    axis = int(np.abs(direction).argmax())
    normal = np.sign(direction[axis]) * np.eye(3)[axis]
    cut = float(normal @ place)
    kept = list[DrawnBody | Glyphs]()
    for part in parts:
        if isinstance(part, DrawnBody):
            kept.append(replace(part, cut=(normal, cut)))
            continue
        is_behind = part.points @ normal >= cut
        vectors = None if part.vectors is None else part.vectors[is_behind]
        if is_behind.any():
            kept.append(replace(part, points=part.points[is_behind], vectors=vectors))
    return kept


def _sample(boundary: Boundary, region: str) -> tuple[Floats, Floats]:
    """Centres and unit normals of some triangles of a region."""
    corners = boundary.points[boundary.triangles[boundary.spread(region, _SYMBOLS)]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)[:, None]
    return corners.mean(axis=1), normals


def _fixings(boundary: Boundary, region: str, axes: Sequence[str], colour: str, size: float) -> Iterator[Glyphs]:
    """Cubes where all displacements are prescribed, else arrows along each prescribed axis or normal, from outside."""
    centres, normals = _sample(boundary, region)
    if len(axes) == 3:
        yield Glyphs(centres, colour, size=0.2 * _SIZE * size)
        return
    for axis in axes:
        if axis == "normal":
            yield Glyphs(centres, colour, -0.6 * _SIZE * size * normals)
            continue
        direction = np.eye(3)["xyz".index(axis)]
        sides = np.where(normals @ direction > 0, -1.0, 1.0)
        yield Glyphs(centres, colour, 0.6 * _SIZE * size * sides[:, None] * direction)


def _outer_arrow(points: Floats, vector: Floats, colour: str, size: float) -> Glyphs:
    """An arrow that ends in front of the body."""
    direction = vector / np.linalg.norm(vector)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    reach = ((points - middle) @ -direction).max() + 0.03 * size
    return Glyphs((middle - reach * direction)[None], colour, 2 * _SIZE * size * direction[None])


def _numbers(value: Any) -> Floats | None:
    """Three numbers that are not all zero, else ``None``: formulas are not drawn."""
    if isinstance(value, list | tuple) and len(value) == 3 and all(isinstance(v, int | float) for v in value):
        return np.array(value, dtype=float) if any(value) else None
    return None


def _rows(data: Mapping[str, Any], section: str) -> list[Mapping[str, Any]]:
    """The section as the user wrote it."""
    return [row if isinstance(row, Mapping) else {} for row in data.get(section) or ()]


def _unknown_pressures(job: Job) -> Iterator[Mapping[str, Any]]:
    """Rows of the legend for the effects of cavities, which follow the job's own."""
    for name, cavity in job.controlled_cavities.items():
        for region in cavity.regions:
            yield {"region": region, "pressure": f"unknown (cavity {name})"}


def _text(given: Mapping[str, Any], head: str) -> str:
    kept = {name: value for name, value in given.items() if f"{name}: {value}" != head}
    more = (
        yaml.safe_dump(kept, default_flow_style=True, sort_keys=False, allow_unicode=True, width=10_000).strip()[1:-1]
        if kept
        else ""
    )
    text = f"{head}, {more}" if more else head
    return text if len(text) <= _TEXT else text[: _TEXT - 1] + "…"
