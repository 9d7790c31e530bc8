"""Pages from templates: one file that needs no other, and no network."""

import math
from datetime import UTC, datetime
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from hpcinv.base.files.atomic import write_output
from hpcinv.base.quantity.written_units import as_shown
from hpcinv.errors import OutputError
from hpcinv.version import __version__

NAME = "report.html"


def render(template: str, **content: Any) -> bytes:
    """Return a page."""
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return _environment().get_template(template).render(version=__version__, written=now, **content).encode()


def write_page(path: Path, page: bytes) -> None:
    """Write a page, completely or not at all; raises ``OutputError`` if that fails."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise OutputError(f"{path}: reports are HTML files", f"Name it {path.with_suffix('.html').name}.")
    write_output(path, page, "Does the directory exist, and is there space?")


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("hpcinv.pages.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["static"] = _static
    environment.filters["number"] = number
    environment.filters["shown_in"] = lambda value, unit, summary, digits=6: as_shown(
        value, unit, summary.get("units") or {}, digits
    )
    environment.filters["megabytes"] = lambda size: f"{size / 1e6:,.0f} MB"
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "ensure_ascii": False, "separators": (",", ":")}
    return environment


@cache
def _static(name: str) -> Markup:
    """Content of a file of the package, to stand in an element ``script`` or ``style``."""
    return Markup(
        files("hpcinv.pages.reports").joinpath("static", name).read_text("utf-8").replace("</script", "<\\/script")
    )


def number(value: Any, unit: str = "") -> str:
    """Return a number, a list of numbers, or a text, to six digits and with a unit."""
    if value is None:
        return "not known"
    if isinstance(value, bool | str):
        return str(value)
    if isinstance(value, list | tuple):
        return f"({', '.join(number(entry) for entry in value)}){f' {unit}' if unit else ''}"
    text = f"{value:.6g}" if math.isfinite(value) else "not finite"
    return f"{text} {unit}" if unit else text
