"""Report of a sweep, from its store."""

import dataclasses
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.quantity.written_units import as_shown
from hpcinv.errors import SystemPartMissing
from hpcinv.output.surfaces.boundary_surface import NAME, Boundary, BoundaryResult, read_boundary
from hpcinv.pages.reports.cases_page import cases_page, outcome_of
from hpcinv.pages.reports.packed_arrays import PackedArrays
from hpcinv.pages.reports.page import NAME as PAGE
from hpcinv.pages.reports.page import write_page
from hpcinv.pages.reports.run_page import write_run_report
from hpcinv.pages.reports.viewer_scene import scene
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.ledger import Ledger
from hpcinv.studies.sweep.results import results
from hpcinv.studies.sweep.shape_spread import kept_file
from hpcinv.studies.sweep.sweep_plan import SweepPlan
from hpcinv.studies.sweep.table import SweepTable, parameter_names

_MOST = 400  # shapes that are read
_LAST = ("key", "started_from")  # columns that few readers need

_CASES = 8  # that the viewer offers in addition to the mean
_PICTURES = 12


def write_sweep_report(plan: SweepPlan, ledger: Ledger, path: Path, *, each: bool = False) -> Path:
    """Write the report of a sweep, finished or not; return the file.

    Args:
        each: write a report of each finished case next to it, in ``cases/``.

    Raises:
        OutputError: a file cannot be written or read.
    """
    records = results(plan, ledger)
    path.parent.mkdir(parents=True, exist_ok=True)
    shapes = _shapes(plan, ledger, records)
    links = _links(plan, ledger, records, path, each=each)
    arrays, body, note, gallery = PackedArrays(), None, "", list[tuple[str, bytes]]()
    if shapes:
        named = list(shapes.values())
        record = ledger.record(next(iter(shapes)))
        if record is not None:
            body, note = mean_and_cases(record.statistics, named, arrays)
        gallery = pictures(named)
    else:
        note = "The cases have kept no shapes; 'set: {output.surface: true}' in another store keeps their boundaries."
    sweep_table = SweepTable(plan, records.items())
    table = sweep_table.columns()
    page = cases_page(
        title=plan.sweep.sweep,
        finding=_found(plan, records),
        notes=[*_notes(plan, records), note],
        columns={name: table[name] for name in sorted(table, key=lambda name: name in _LAST)},
        units=sweep_table.units(),
        parameters=parameter_names(plan),
        results=sweep_table.quantities(),
        outcome=[_outcome(records.get(case.key)) for case in plan.cases],
        links=links,
        body=body,
        arrays=arrays.texts(),
        gallery=gallery,
        gallery_note=f"{len(gallery)} of {len(shapes)} shapes that were found, coloured by displacement, on one scale.",
    )
    write_page(path, page)
    return path


def _outcome(record: CaseRecord | None) -> str:
    return "open" if record is None else outcome_of(converged=record.converged, verdict=record.verdict)


def _found(plan: SweepPlan, records: Mapping[str, CaseRecord]) -> str:
    outcome = Counter(_outcome(records.get(case.key)) for case in plan.cases)
    parts = [f"{outcome['good']} of {len(plan.cases)} cases are solved without doubt"]
    if outcome["doubtful"]:
        parts.append(f"{outcome['doubtful']} with warnings or checks without decision")
    if outcome["bad"]:
        parts.append(f"{outcome['bad']} failed")
    if outcome["open"]:
        parts.append(f"{outcome['open']} are open")
    return ", ".join(parts) + "."


def _notes(plan: SweepPlan, records: Mapping[str, CaseRecord]) -> list[str]:
    """Return the reasons why cases failed, the most frequent first."""
    failed = [record for case in plan.cases if (record := records.get(case.key)) and not record.converged]
    why = Counter(record.diagnosis for record in failed)
    advice = {record.diagnosis: record.advice for record in failed}
    return [f"{count} failed: {text}. {advice[text]}".strip() for text, count in why.most_common(5)]


def _shapes(plan: SweepPlan, ledger: Ledger, records: Mapping[str, CaseRecord]) -> dict[str, tuple[str, Boundary]]:
    """Titles and boundaries of cases that have kept one, by key."""
    shapes = dict[str, tuple[str, Boundary]]()
    for case in plan.cases:
        record = records.get(case.key)
        if record is None or not record.converged or case.key in shapes or len(shapes) >= _MOST:
            continue
        file = kept_file(ledger.directory(case.key), NAME)
        if file is not None:
            shapes[case.key] = (case.title, read_boundary(file))
    return shapes


def _links(plan: SweepPlan, ledger: Ledger, records: Mapping[str, CaseRecord], path: Path, *, each: bool) -> list[str]:
    """Addresses of the reports of cases, relative to the page; empty where there is none."""
    links = []
    for case in plan.cases:
        report = kept_file(ledger.directory(case.key), PAGE)
        if report is None and each and case.key in records:
            report = _case_report(ledger, case.key, path.parent / "cases" / f"case-{case.number}.html")
        links.append("" if report is None else Path(os.path.relpath(report, path.parent)).as_posix())
    return links


def _case_report(ledger: Ledger, key: str, path: Path) -> Path | None:
    record = ledger.record(key)
    if record is None or not record.statistics:
        return None
    path.parent.mkdir(exist_ok=True)
    surface = kept_file(ledger.directory(key), NAME)
    directory = ledger.directory(key) if surface is None else surface.parent
    return write_run_report(directory, record.statistics, path)


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
