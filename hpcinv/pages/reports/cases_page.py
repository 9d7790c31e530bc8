"""Report of many runs: a table, a map of the cases, parallel coordinates, diagrams and shapes."""

import base64
from collections.abc import Mapping, Sequence
from typing import Any

from hpcinv.base.files.json_data import json_data
from hpcinv.pages.reports.page import render

_AXES = 9  # of the parallel coordinates
_VERDICTS = {"bad": "fail", "doubtful": "warning", "open": "open"}  # of the page, by the worst outcome


def outcome_of(*, converged: bool, verdict: str) -> str:
    """Return the outcome of a finished case: good, doubtful or bad."""
    if not converged or verdict == "fail":
        return "bad"
    return "doubtful" if verdict in ("warning", "not decided") else "good"


def _entry(value: Any) -> Any:
    return str(value).lower() if isinstance(value, bool) else json_data(value)


def _pictures(named: Sequence[tuple[str, bytes]]) -> list[dict[str, str]]:
    return [{"title": name, "source": as_url(png)} for name, png in named]


def cases_page(
    *,
    title: str,
    finding: str,
    notes: Sequence[str],
    columns: Mapping[str, Sequence[Any]],
    units: Mapping[str, str],
    parameters: Sequence[str],
    results: Sequence[str],
    outcome: Sequence[str],
    links: Sequence[str] = (),
    diagrams: Sequence[tuple[str, bytes]] = (),
    body: Mapping[str, Any] | None = None,
    arrays: Sequence[str] = (),
    gallery: Sequence[tuple[str, bytes]] = (),
    gallery_note: str = "",
) -> bytes:
    """Return the page of a sweep or a study.

    Args:
        finding: what was found, in one sentence; ``notes``: more.
        columns: a list for each column, with one entry for each case; the first one numbers them.
        units: of columns, as far as they are known.
        parameters, results: columns of the parallel coordinates and of the map.
        outcome: of each case: good, doubtful, bad or open.
        links: address of each case's report, relative to the page's, or empty.
        diagrams: titles and PNG pictures.
        body: of `shapes_of`, with its ``arrays``.
        gallery: titles and PNG pictures of shapes.
    """
    names = [name for name, values in columns.items() if any(v not in (None, "") for v in values)]
    shown = [_column(name, units.get(name, ""), columns[name]) for name in names]
    rows = [list(map(_entry, row)) for row in zip(*(columns[name] for name in names), strict=True)]
    axes = [names.index(name) for name in [*parameters, *results] if name in names][:_AXES]
    numbers = [name for name in results if name in names] or names[-1:]
    return render(
        "cases.html",
        title=title,
        verdict=next((verdict for kind, verdict in _VERDICTS.items() if kind in outcome), "pass"),
        found=finding,
        notes=notes,
        columns=shown,
        rows=rows,
        links=links or [""] * len(rows),
        example=f"{numbers[0]} > 0.1" if numbers else "seconds > 2",
        diagrams=_pictures(diagrams),
        data={"columns": shown, "rows": rows, "outcome": list(outcome), "axes": axes},
        body=body,
        arrays=arrays,
        gallery=_pictures(gallery),
        gallery_note=gallery_note,
        size="",
        picture="",
    )


def _column(name: str, unit: str, values: Sequence[Any]) -> dict[str, Any]:
    is_text = any(isinstance(value, str) for value in values)
    return {"name": name, "unit": unit, "text": is_text, "label": f"{name} ({unit})" if unit else name}


def as_url(png: bytes) -> str:
    """Return a PNG as address of its data."""
    return f"data:image/png;base64,{base64.b64encode(png).decode()}"
