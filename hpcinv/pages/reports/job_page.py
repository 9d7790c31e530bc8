"""Page of a job before it runs, or of a mesh: places and regions to click, and the text of the job with new ones."""

from __future__ import annotations

from typing import Any

import numpy as np

from hpcinv.base.quantity.arrays import Floats, Ints
from hpcinv.base.quantity.units import length_symbol, parse_quantity, readable
from hpcinv.base.quantity.written_units import written_units
from hpcinv.job.job import Job
from hpcinv.job.mesh_file import IMAGES
from hpcinv.mesh import Body
from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.surface import Surface, gather_surface
from hpcinv.output.surfaces.boundary_surface import Boundary
from hpcinv.output.surfaces.decimation import Decimated, decimated
from hpcinv.output.surfaces.gathering import boundary_of, cut_of
from hpcinv.output.surfaces.interior_gathering import interior_of
from hpcinv.pages.reports.job_text import place_of_entries
from hpcinv.pages.reports.packed_arrays import PackedArrays
from hpcinv.pages.reports.page import render
from hpcinv.pages.reports.symbols import symbols
from hpcinv.pages.reports.viewer_scene import axes_of, packed_interior, regions_of, shown_units

_AROUND = {3: [0, 1, 2], 4: [0, 1, 3, 2]}  # order of the vertices around a facet


def job_page(name: str, body: Body, job: Job | None, text: str, symbol: str, save: str = "") -> bytes:
    """Return the page of a job, or of a mesh without one.

    Args:
        text: of the job as it is written; empty without one.
        symbol: of the unit of lengths.
        save: address that takes what is added; without one, the page offers the text as a file.
    """
    arrays = PackedArrays()
    boundary = boundary_of(body)
    surface = gather_surface(body, body.given_nodes)
    assert boundary is not None  # there is one rank
    assert surface is not None
    page = _scene(name, body, job, boundary, surface, arrays)
    size = parse_quantity(f"1 {symbol}")[0]
    page["unit"] = [size, symbol]
    page["units"] = shown_units({"units": written_units(job.data)}) if job else {}
    place = place_of_entries(text)
    page["job"] = vars(place) | {"file": f"{name}.yaml" if job else "regions.yaml", "save": save}
    page["quantities"] = [quantity.name for quantity in job.quantities] if job else []
    page["arrays"] = arrays.specs
    sides = " × ".join(f"{side / size:.4g}" for side in np.ptp(boundary.points, axis=0))
    cells = f"{body.mesh.topology.index_map(3).size_global:,}"
    return render(
        "job.html",
        title=name,
        body=page,
        arrays=arrays.texts(),
        size=f"{sides} {symbol}",
        facts=f"{cells} {body.source.kind} cells, {readable(_volume(boundary), 'm^3')} inside its surface",
        has_job=job is not None,
        is_editor=bool(save),
    )


def _scene(
    name: str, body: Body, job: Job | None, boundary: Boundary, surface: Surface, arrays: PackedArrays
) -> dict[str, Any]:
    kept = decimated(boundary.points, boundary.triangles)
    is_part = len(kept.points) < len(boundary.points)
    labels = [where.partition(".")[2] for where in job.laws] if job else []
    interior = interior_of(body, (), labels)
    vertices, rows, facet = _facets(boundary, surface, kept, is_part=is_part)
    regions = regions_of(boundary, kept, arrays, interior)
    loads = _symbols(job, boundary, kept)
    up = next((load["vector"] for load in loads if load["kind"] == "load" and load["body"] and load["vector"]), None)
    taken = [region for region in body.regions if region != "boundary"]
    return {
        "kind": "job",
        "name": name,
        "up": [0.0, 0.0, 1.0] if up is None else [-component for component in up],
        "axes": axes_of(job.mesh.model_dump(mode="json") if job else {"file": str(body.source.path)}),
        "triangles": arrays.add_whole(kept.triangles),
        "points": arrays.add(boundary.points[kept.points]),
        "facet": arrays.add_whole(facet),
        "facets": {
            "vertices": arrays.add_whole(np.ascontiguousarray(vertices).view(np.uint16)),
            "rows": arrays.add_whole(rows.reshape(-1, 1)),
            "sides": rows.shape[1],
        },
        "decimated": is_part,
        "interior": packed_interior(interior, arrays),
        "regions": regions
        | {
            "taken": taken,
            "labels": [region for region in regions["names"] if body.regions[region].cell_count],
            "texts": [_count(body, region) for region in regions["names"]],
        },
        "symbols": loads,
    }


def _count(body: Body, name: str) -> str:
    region = body.regions[name]
    counts = [(region.facet_count, "facets"), (region.cell_count, "cells")]
    return f"{name}: {', '.join(f'{count:,} {what}' for count, what in counts if count)}"


def _facets(boundary: Boundary, surface: Surface, kept: Decimated, *, is_part: bool) -> tuple[Floats, Ints, Ints]:
    """Vertices (n, 3), numbers of each facet's as seen from outside, (f, k), and the facet of each drawn triangle."""
    if is_part:
        return boundary.points[kept.points], kept.triangles, np.arange(len(kept.triangles))
    count = vertex_count(surface.kind)
    tags = surface.tags[:, :count][:, _AROUND[count]]
    _, first, rows = np.unique(tags, return_index=True, return_inverse=True)
    vertices = surface.nodes[:, :count][:, _AROUND[count]].reshape(-1, 3)[first]
    rows = rows.reshape(tags.shape)
    rows = np.where(surface.outward[:, None], rows, rows[:, ::-1])
    return vertices, rows, cut_of(surface).facet


def _symbols(job: Job | None, boundary: Boundary, kept: Decimated) -> list[dict[str, Any]]:
    """Supports and loads in the units of the job; of a job with states, in the state that is solved first."""
    if job is None:
        return []
    first = job.plan[0].job
    drawn = symbols(first.model_dump(mode="json"), {}, boundary, written_units(job.data))
    place = {int(old): new for new, old in reversed(list(enumerate(kept.rows)))}
    for symbol in drawn:
        symbol["rows"] = [place[row] for row in symbol["rows"] if row in place]
    return drawn


def _volume(boundary: Boundary) -> float:
    a, b, c = (boundary.points[boundary.triangles[:, k]] for k in range(3))
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def length_unit_of(job: Job | None, body: Body) -> str:
    """Return the unit of lengths of a job: the one that it writes most often, else the unit of its mesh."""
    written = written_units(job.data) if job else {}
    is_image = str(body.source.path).endswith(IMAGES)
    return written.get("m") or ("mm" if is_image else length_symbol(body.source.unit or 1.0))
