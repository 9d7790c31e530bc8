"""Report of a run, from its directory: summary, boundary and snapshots."""

import contextlib
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import ValidationError

from hpcinv.base.quantity.written_units import as_shown
from hpcinv.errors import HpcinvError, OutputError, SystemPartMissing
from hpcinv.job.quantity_of_interest import QuantityOfInterest, is_of_nodes
from hpcinv.job.vocabulary import REACTIONS
from hpcinv.output.surfaces import boundary_surface as surface
from hpcinv.output.surfaces import snapshots
from hpcinv.output.surfaces.boundary_surface import Boundary, read_boundary
from hpcinv.output.surfaces.interior import NAME as NAME_OF_INTERIOR
from hpcinv.output.surfaces.interior import Interior, read_interior
from hpcinv.output.surfaces.snapshots import Snapshot, read_snapshots
from hpcinv.output.text_report import intervals_of
from hpcinv.pages.reports.cases_page import as_url
from hpcinv.pages.reports.charts import convergence_chart, load_chart
from hpcinv.pages.reports.packed_arrays import PackedArrays
from hpcinv.pages.reports.page import NAME, render, write_page
from hpcinv.pages.reports.viewer_scene import scene
from hpcinv.pages.reports.wording import words

_STRAINED = 1.001  # stretch, or its inverse, that is worth a word
_KEYS = {"status", "job", "solutions", "certificate", "timings", "peak_memory", "versions", "mesh"}


def write_run_report(directory: Path, summary: Mapping[str, Any] | None, path: Path | None = None) -> Path:
    """Write the report of a run, without its solver; return the file.

    It reads the boundary, not the fields in the body.

    Args:
        summary: content of ``summary.json``, ``None`` if there is none.
        path: by default ``report.html`` in the directory.

    Raises:
        OutputError: the directory has no run, a file there is damaged, or the report cannot be written.
    """
    if summary is None or not summary.keys() >= _KEYS:
        raise OutputError(
            f"{directory}: has no summary of a run, or it is damaged",
            "Give the directory that 'run' printed at its beginning; one that was killed needs 'resume'.",
        )
    boundary, steps, interior = None, list[Snapshot](), None
    if (directory / surface.NAME).exists():
        boundary, steps = read_boundary(directory / surface.NAME), read_snapshots(directory / snapshots.NAME)
        interior = read_interior(directory / NAME_OF_INTERIOR)
    path = path or directory / NAME
    try:
        page = run_page(summary, boundary, steps, interior)
    except (KeyError, TypeError, IndexError, AttributeError, ValueError) as error:
        raise OutputError(
            f"{directory}: its summary does not have what a report needs ({type(error).__name__}: {error})",
            "Was it written by another version of hpcinv? Run the job again.",
        ) from error
    write_page(path, page)
    return path


def run_page(
    summary: Mapping[str, Any],
    boundary: Boundary | None,
    steps: Sequence[Snapshot],
    interior: Interior | None = None,
) -> bytes:
    """Return the page of a run; ``boundary`` is ``None`` if none was kept."""
    if interior is not None and (boundary is None or len(interior.results) != len(boundary.results)):
        interior = None
    arrays, body, picture = PackedArrays(), None, ""
    if boundary is not None and boundary.results:
        body = scene(summary, boundary, steps, arrays, interior)
        body["arrays"] = arrays.specs
        del body["kept"]
        picture = _picture(summary, boundary)
    overlapping = boundary is not None and any(result.crossing.any() for result in boundary.results)
    certificate = summary["certificate"]
    return render(
        "run.html",
        title=summary["job"]["job"],
        summary=summary,
        words=words(summary, overlapping=overlapping, strained=_strained(boundary)),
        body=body,
        arrays=arrays.texts(),
        picture=picture,
        size="" if boundary is None else boundary.size,
        quantities=quantity_rows(summary),
        lines=[{"meaning": "", "state": ""} | line for line in certificate["lines"]],
        seconds_of_checks=sum(line["seconds"] or 0.0 for line in certificate["lines"]),
        newton=_newton(summary["solutions"]),
        phases=_phases(summary),
        job_text=yaml.safe_dump(_short(summary["job"]), sort_keys=False, allow_unicode=True),
        fingerprint=yaml.safe_dump(summary.get("fingerprint"), sort_keys=False, allow_unicode=True),
    )


def _strained(boundary: Boundary | None) -> str:
    """Return where the boundary of the last body is strained most; empty if it is not strained."""
    if boundary is None or not boundary.results:
        return ""
    last = boundary.results[-1]
    size = np.maximum(last.stretches[:, 0], 1 / np.maximum(last.stretches[:, 2], np.finfo(float).tiny))
    row = int(size.argmax())
    if size[row] < _STRAINED:
        return ""
    x, y, z = last.mesh[boundary.triangles[row]].mean(axis=0)
    largest, smallest = last.stretches[row, 0], last.stretches[row, 2]
    return (
        f"Its boundary is strained most near ({x:.4g}, {y:.4g}, {z:.4g}) m: stretches {smallest:.3g} to"
        f" {largest:.3g}, J = {last.J[row]:.3g}."
    )


def _picture(summary: Mapping[str, Any], boundary: Boundary) -> str:
    """The picture for paper and browsers without WebGL as data URL; empty where none can be drawn."""
    from hpcinv.pages.pictures.result_picture import draw_result  # loads VTK

    with contextlib.suppress(SystemPartMissing):
        return as_url(draw_result(summary, boundary).png)
    return ""


def quantity_rows(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of the table of quantities: units, estimated errors and their bars, standard deviations and intervals."""
    estimate = summary["certificate"].get("estimate") or {}
    errors, given = estimate.get("quantities", {}), summary["job"].get("quantities", [])
    rows = []
    for name, value in summary["quantities"].items():
        quantity = next((q for q in given if name == q["name"] or name.startswith(f"{q['name']}-")), None)
        error, unit = errors.get(name), (summary.get("quantity_units") or {}).get(name)
        unit = ("" if quantity is None else _unit(quantity)) if unit is None else unit
        bar = _bar(value, error)
        formula = "" if quantity is None else _formula(quantity, summary["job"])
        row = {"name": name, "value": value, "error": error, "unit": unit, "of": formula, "bar": bar}
        text = partial(as_shown, unit=unit, symbols=summary.get("units") or {})
        row |= {"text": text(value), "error_text": "not estimated" if error is None else text(error)}
        deviations = [(text(sd), cause) for sd, cause in _deviations(summary, name)]
        rows.append(row | {"deviations": [*deviations, *intervals_of(summary, name, text)]})
    return rows


def _formula(quantity: Mapping[str, Any], job: Mapping[str, Any]) -> str:
    of_nodes = is_of_nodes(quantity, job.get("let", {}))
    return f"{quantity['of']} ({quantity['reduce']} of the nodes)" if of_nodes else str(quantity["of"])


def _deviations(summary: Mapping[str, Any], name: str) -> list[tuple[Any, str]]:
    """Standard deviations of a quantity, with their causes."""
    parameter_deviations = ((summary.get("sensitivities") or {}).get("quantities") or {}).get(name) or {}
    surface_deviations = (summary.get("surface_errors") or {}).get("quantities") or {}
    deviations = [
        (parameter_deviations.get("sd"), "by the parameters"),
        (surface_deviations.get(name), "by errors of the given surface"),
    ]
    return [(sd, cause) for sd, cause in deviations if sd is not None]


def _bar(value: Any, error: Any) -> dict[str, float] | None:
    """Relative error, and the width of its bar in percent on a logarithmic scale from 1e-6 to 1."""
    if not isinstance(value, int | float) or not isinstance(error, int | float) or not error:
        return None
    relative = abs(error) / max(abs(value), abs(error))
    return {"relative": relative, "width": 100 * min(1.0, max(0.02, 1 + math.log10(relative) / 6))}


def _unit(quantity: Mapping[str, Any]) -> str:
    with contextlib.suppress(ValidationError, HpcinvError, ValueError, TypeError):
        return QuantityOfInterest.model_validate(dict(quantity)).unit
    return REACTIONS.get(str(quantity["of"]).strip(), "")


def _newton(solutions: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Charts and table of each solution: corrections and residuals over the iterations, and the load of each solve."""
    charts_of_solutions = []
    for solution in solutions:
        state = f" of state '{solution['state']}'" if solution.get("state") else ""
        title, solves = f"Newton's method, {solution['direction']} solution{state}", solution["solves"]
        charts = {"chart": convergence_chart(solves, title), "path": load_chart(solves, f"{title}: load")}
        charts_of_solutions.append({"title": title, **charts, "solves": solves, "linear": solution.get("linear")})
    return charts_of_solutions


def _phases(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of the table of phases, the longest first."""
    timings, memory = summary["timings"], summary["peak_memory"]["phases"]
    total = timings["total"] or 1.0
    rows = [
        {
            "name": name,
            "least": s["min"],
            "most": s["max"],
            "share": 100 * s["max"] / total,
            "memory": memory.get(name, {}).get("max"),
        }
        for name, s in timings["phases"].items()
    ]
    return sorted(rows, key=lambda row: -float(row["most"]))


def _short(value: Any) -> Any:
    """The job without its empty sections."""
    if isinstance(value, Mapping):
        return {key: _short(entry) for key, entry in value.items() if entry not in (None, {}, [], ())}
    return [_short(entry) for entry in value] if isinstance(value, list) else value
