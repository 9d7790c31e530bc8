"""Several states of a body as steps of a deck of CalculiX or Abaqus: each has its loads alone (``OP=NEW``)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hpcinv.errors import OutputError
from hpcinv.studies.second_opinion.loaded_body import LoadedBody


def check_steps(body: LoadedBody) -> None:
    """Raise ``OutputError`` if the steps of a body differ in more than their loads."""
    for later in body.steps:
        if reason := _difference(body, later):
            text = f"steps: {reason}; in a deck of several states only loads differ"
            raise OutputError(text, "Export a deck of each state, with --shape NAME.")
        body.density, body.densities = max(body.density, later.density), body.densities or later.densities


def _difference(body: LoadedBody, later: LoadedBody) -> str:
    """Return what a later state has that is not a load of the same body; empty if there is nothing."""
    both = body, later
    reasons = {
        "a region is rigid": any(part.remotes for part in both),
        "a support moves": any(held.values.any() for part in both for held in part.held),
        "supports differ": _held(body) != _held(later),
        "foundations differ": _springs(body) != _springs(later) or any(f.is_current for f in later.foundations),
        "there is thermal expansion": any(part.expansion for part in both),
        "densities differ": bool(body.density and later.density) and _densities(body) != _densities(later),
    }
    return next((reason for reason, is_so in reasons.items() if is_so), "")


def _held(body: LoadedBody) -> list[Any]:
    """Return regions, axes and directions of supports; directions have rounding errors."""
    slides = [(slide.region, slide.nodes.tolist(), slide.directions.round(9).tolist()) for slide in body.slides]
    return [*((held.axis, held.region, held.nodes.tolist()) for held in body.held), *slides]


def _springs(body: LoadedBody) -> list[Any]:
    return [(f.group.name, f.normal, f.tangential, f.is_current) for f in body.foundations]


def _densities(body: LoadedBody) -> Any:
    return body.density, body.densities


def without_earlier_loads() -> Iterator[str]:
    """Yield the lines that end the loads of the steps before."""
    yield "*DLOAD, OP=NEW\n*CLOAD, OP=NEW\n"


def later_path(path: Path, number: int) -> Path:
    """Return the file with the places of the nodes after a step, from 2."""
    return path.with_name(f"{path.stem}-{number}{path.suffix}")
