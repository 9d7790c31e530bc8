"""Page of an identification, from what its directory has."""

import json
from pathlib import Path
from typing import Any

from hpcinv.base.reading.door import admitted
from hpcinv.errors import OutputError
from hpcinv.pages.reports.cases_page import as_url
from hpcinv.pages.reports.page import NAME, render, write_page

FIGURES = "identification.json"


def write_identification_report(directory: Path, output: Path | None) -> Path:
    """Write the page of an identification; return its file.

    Raises:
        OutputError: the figures are damaged, or the page cannot be written.
    """
    source = directory / FIGURES
    try:
        figures: dict[str, Any] = json.loads(admitted(source).read_text("utf-8"))
        curves = [{**curve, "picture": _picture(directory, curve["name"])} for curve in figures["curves"]]
        chance = figures["probability"]
        page = render(
            "identification.html",
            title=directory.resolve().name,
            verdict="warning" if figures["warnings"] else "pass",
            finding=f"χ² is {figures['chi_squared']:.4g} with {figures['degrees_of_freedom']} degrees of freedom"
            + (f"; as large by chance: {chance:.2g}." if chance is not None else "."),
            figures=figures,
            curves=curves,
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise OutputError(
            f"{source}: cannot be read ({type(error).__name__}: {error})",
            "Run 'hpcinv identify' again: finished evaluations are used again.",
        ) from None
    path = output or directory / NAME
    write_page(path, page)
    return path


def _picture(directory: Path, name: str) -> str:
    path = directory / f"curve-{name}.png"
    return as_url(admitted(path).read_bytes()) if path.is_file() else ""
