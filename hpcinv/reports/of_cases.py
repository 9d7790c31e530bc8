"""Report of many runs: a table, a map of the cases, parallel coordinates, diagrams and shapes."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hpcinv.files.json_data import json_data
from hpcinv.reports.arrays import Arrays
from hpcinv.reports.page import render

_AXES = 9  # of the parallel coordinates


@dataclass(frozen=True)
class Cases:
    """Content of the report of a sweep or a study.

    Attributes:
        found: what was found, in one sentence; ``notes``: more.
        columns: a list for each column, with one entry for each case; the first one numbers them.
        units: of columns, as far as they are known.
        parameters, results: columns of the parallel coordinates and of the map.
        outcome: of each case: good, doubtful, bad or open.
        links: address of each case's report, relative to that of the page, or empty.
        diagrams: titles and PNG pictures.
        body: of `shapes_of`, with its arrays.
        gallery: titles and PNG pictures of shapes.
    """

    title: str
    found: str
    notes: Sequence[str]
    columns: Mapping[str, Sequence[Any]]
    units: Mapping[str, str]
    parameters: Sequence[str]
    results: Sequence[str]
    outcome: Sequence[str]
    links: Sequence[str] = ()
    diagrams: Sequence[tuple[str, bytes]] = ()
    body: Mapping[str, Any] | None = None
    arrays: Arrays = field(default_factory=Arrays)
    gallery: Sequence[tuple[str, bytes]] = ()
    gallery_note: str = ""


def outcome_of(*, converged: bool, verdict: str) -> str:
    """Return the outcome of a finished case: good, doubtful or bad."""
    if not converged or verdict == "fail":
        return "bad"
    return "doubtful" if verdict in ("warning", "not decided") else "good"


def cases_page(cases: Cases) -> bytes:
    """Return the page."""
    names = [name for name, values in cases.columns.items() if any(v not in (None, "") for v in values)]
    columns = []
    for name in names:
        unit, values = cases.units.get(name, ""), cases.columns[name]
        text = any(isinstance(v, str) for v in values if v is not None)
        columns.append({"name": name, "unit": unit, "text": text, "label": f"{name} ({unit})" if unit else name})
    table = zip(*(cases.columns[name] for name in names), strict=True)
    rows = [[str(v).lower() if isinstance(v, bool) else json_data(v) for v in row] for row in table]
    axes = [names.index(name) for name in [*cases.parameters, *cases.results] if name in names][:_AXES]
    bad, doubtful = cases.outcome.count("bad"), cases.outcome.count("doubtful")
    numbers = [name for name in cases.results if name in names] or names[-1:]
    return render(
        "cases.html",
        title=cases.title,
        verdict="fail" if bad else "warning" if doubtful else "pass" if "open" not in cases.outcome else "open",
        found=cases.found,
        notes=cases.notes,
        columns=columns,
        rows=rows,
        links=cases.links or [""] * len(rows),
        example=f"{numbers[0]} > 0.1" if numbers else "seconds > 2",
        diagrams=[{"title": title, "source": as_url(png)} for title, png in cases.diagrams],
        data={"columns": columns, "rows": rows, "outcome": list(cases.outcome), "axes": axes},
        body=cases.body,
        arrays=cases.arrays.texts(),
        gallery=[{"title": title, "source": as_url(png)} for title, png in cases.gallery],
        gallery_note=cases.gallery_note,
        size="",
        picture="",
    )


def as_url(png: bytes) -> str:
    """Return a PNG as address of its data."""
    return f"data:image/png;base64,{base64.b64encode(png).decode()}"
