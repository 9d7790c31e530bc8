"""Shapes of many cases: their mean, their standard deviation, and small pictures of some."""

import dataclasses
from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from hpcinv.base.quantity.written_units import as_shown
from hpcinv.errors import SystemPartMissing
from hpcinv.output.surfaces.boundary_surface import Boundary, BoundaryResult
from hpcinv.pages.reports.packed_arrays import PackedArrays
from hpcinv.pages.reports.viewer_scene import scene

_CASES = 8  # that the viewer offers in addition to the mean
_PICTURES = 12


def mean_and_cases(
    summary: Mapping[str, Any], named: Sequence[tuple[str, Boundary]], arrays: PackedArrays
) -> tuple[dict[str, Any] | None, str]:
    """Return the data of the viewer with the mean shape and some of the cases, and a note.

    There is none if the meshes differ. The first state of each body counts.

    Args:
        summary: of one of the cases.
        named: titles and boundaries of cases.
    """
    first = named[0][1]
    if not all(np.array_equal(entry.triangles, first.triangles) for _, entry in named):
        return None, "There is no mean shape, since the meshes of the cases differ in more than positions of nodes."
    results = [boundary.results[0] for _, boundary in named]
    shapes = np.stack([result.others for result in results])
    deviation = np.sqrt(shapes.var(axis=0, ddof=1 if len(shapes) > 1 else 0).sum(axis=1))
    mesh, stress, J, stretches = (
        np.mean(np.stack(list(map(attrgetter(name), results))), axis=0) for name in ("mesh", "stress", "J", "stretches")
    )
    crossing = np.any([result.crossing for result in results], axis=0)
    title, direction = f"mean of {len(results)} cases", results[0].direction
    mean = BoundaryResult(
        title, direction, mesh, shapes.mean(axis=0), stress=stress, J=J, stretches=stretches, crossing=crossing
    )
    some = [dataclasses.replace(results[i], state=named[i][0], fibres={}) for i in _spread(len(results), _CASES)]
    boundary = dataclasses.replace(first, points=mean.mesh, results=(mean, *some), error=None, fibres={})
    body = scene({**summary, "states": {}}, boundary, [], arrays)
    for entry in body["results"]:
        entry["deformed"] = "deformed"
    body["results"][0]["deviation"] = arrays.add(deviation[body.pop("kept")])
    body |= {"choice": "Shape", "arrays": arrays.specs}
    largest = as_shown(float(deviation.max()), "m", summary.get("units") or {}, 3)
    return body, f"Largest standard deviation of a point of the boundary: {largest}."


def pictures(named: Sequence[tuple[str, Boundary]]) -> list[tuple[str, bytes]]:
    """Draw the shapes that some cases have found from one direction; none without OpenGL."""
    from hpcinv.pages.pictures.drawing import DrawnBody, View, directions, thumbnail  # loads VTK

    chosen = [named[i] for i in _spread(len(named), _PICTURES)]
    frame = np.concatenate([boundary.results[0].others for _, boundary in chosen])
    front, _, up = directions(frame)
    sizes = [np.linalg.norm(boundary.results[0].displacement, axis=1) for _, boundary in chosen]
    limits = (0.0, max(float(size.max()) for size in sizes))
    drawings = []
    try:
        for (title, boundary), size in zip(chosen, sizes, strict=True):
            body = DrawnBody(boundary.results[0].others, boundary.triangles, values=size)
            drawings.append((title, thumbnail(View([body], frame, front, up), limits)))
    except SystemPartMissing:
        return []
    return drawings


def _spread(count: int, most: int) -> list[int]:
    """Some of the numbers below ``count``, evenly."""
    chosen: list[int] = np.unique(np.linspace(0, count - 1, min(most, count)).astype(int)).tolist()
    return chosen
