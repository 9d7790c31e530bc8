"""Content of a dossier, from the files of a run: nothing here is computed again.

Sources: ASME V&V 40-2018; FDA, "Assessing the Credibility of Computational Modeling and Simulation in Medical Device
Submissions" (2023), FDA-2021-D-0980; FDA, "Reporting of Computational Modeling Studies in Medical Device Submissions"
(2016).
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import UndefinedError

from hpcinv.base.mesh_formats import FORMATS
from hpcinv.base.reading.door import admitted
from hpcinv.errors import OutputError
from hpcinv.pages.reports.page import render
from hpcinv.pages.reports.run_page import quantity_rows
from hpcinv.pages.reports.wording import words
from hpcinv.studies.dossier.context import OPEN, DossierContext

NAME = "dossier.html"


def dossier_page(
    directory: Path, summary: Mapping[str, Any], context: DossierContext, identified: Mapping[str, Any] | None = None
) -> bytes:
    """Return the page of a finished run.

    Args:
        identified: figures of the identification whose estimate was run.

    Raises:
        OutputError: the run is not finished, its summary lacks something, or a file cannot be read.
    """
    if summary.get("status") != "converged":
        raise OutputError(
            f"{directory}: the run did not reach its end ({summary.get('status')})",
            "A dossier needs a finished run: see its report.",
        )
    missing = sorted(name for name, value in context if not value and name not in ("limits", "dossier"))
    try:
        inputs, counts = properties(summary), published()
        return render(
            "dossier.html",
            title=context.title or f"Credibility dossier: {summary['job']['job']}",
            context=context,
            open=OPEN,
            missing=missing,
            hashes=list(_hashes(directory)),
            directory=directory.name,
            summary=summary,
            words=words(summary, overlapping=False),
            properties=inputs,
            quantities=[_with_identified(row, identified) for row in quantity_rows(summary)],
            identified=identified,
            published=counts,
            factors=list(_factors(summary, context, inputs, counts)),
            limits=[*_limits(summary), *context.limits],
        )
    except (KeyError, TypeError, IndexError, AttributeError, ValueError, UndefinedError) as error:
        lacking = "summary" if identified is None else "identification"
        again = "Run the job" if identified is None else "Run 'hpcinv identify'"
        raise OutputError(
            f"{directory}: its {lacking} lacks what a dossier needs ({type(error).__name__}: {error})",
            f"Was it written by another version of hpcinv? {again} again.",
        ) from error


def _with_identified(row: dict[str, Any], identified: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the row of a quantity with its standard deviation by identified parameters, and their correlations."""
    if identified is None or row["name"] not in identified["quantities"]:
        return row
    own = (identified["quantities"][row["name"]]["text"].partition("±")[2].strip(), "by the identified parameters")
    return row | {"deviations": [own, *row["deviations"]]}


def properties(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return numbers and vectors (SI) of laws and effects by their keys: what needs a source."""
    job = summary["job"]
    return {
        key: value for section in ("material", "effects", "states") for key, value in _values(job[section], section)
    }


def _values(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    if _is_number(value) or (isinstance(value, list) and value and all(map(_is_number, value))):
        yield key, value
    elif isinstance(value, Mapping):
        for name, entry in value.items():
            yield from _values(entry, f"{key}.{name}")
    elif isinstance(value, list):
        for place, entry in enumerate(value):
            yield from _values(entry, f"{key}[{place}]")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def published() -> Mapping[str, Any]:
    """Return the counts of values that others published, of this version; empty if they were not made."""
    file = files("hpcinv.studies.dossier").joinpath("published.json")
    return json.loads(file.read_text("utf-8")) if file.is_file() else {}


def _factors(
    summary: Mapping[str, Any], context: DossierContext, inputs: Mapping[str, Any], counts: Mapping[str, Any]
) -> Iterator[tuple[str, str, str]]:
    """Yield the credibility factors of V&V 40: group, factor, and what is known."""
    certificate = summary["certificate"]
    estimate = certificate.get("estimate") or {}
    made = [line for line in certificate["lines"] if line["verdict"] != "not checked"]
    shape = estimate.get("shape")
    error = "not estimated" if shape is None else f"shape {shape:.3g} m; quantities in section 8"
    evidence = f"{len(context.validation)} comparisons in section 9" if context.validation else OPEN
    verified = f"{counts['inside']} of {counts['values']} published values inside both errors" if counts else "not made"
    yield "code verification", "software quality assurance", "tests and continuous integration of hpcinv"
    yield "code verification", "numerical code verification", verified
    yield "calculation verification", "discretization error", error
    yield "calculation verification", "numerical solver error", _solver_error(made)
    yield "calculation verification", "use error", "inputs identified by hashes (section 11); warnings in section 10"
    yield "model", "model form", "static continuum; law, loads and supports in sections 3 and 4"
    named = sum(bool(context.sources.get(key)) for key in inputs)
    yield "model", "model inputs", f"{named} of {len(inputs)} sources named" if named else OPEN
    for group, factors in (
        ("comparator", ("test samples", "test conditions")),
        ("assessment", ("equivalency of input parameters", "output comparison")),
        ("applicability", ("relevance of the quantities of interest", "relevance of the validation activities")),
    ):
        for factor in factors:
            yield group, factor, evidence


def _solver_error(lines: list[Mapping[str, Any]]) -> str:
    residual = next((line for line in lines if line["name"].startswith("equilibrium residual")), None)
    return (
        "not checked" if residual is None else f"residual {residual['value']:.2g} of the load ({residual['verdict']})"
    )


def _limits(summary: Mapping[str, Any]) -> Iterator[str]:
    """Yield limits that the run itself states."""
    certificate = summary["certificate"]
    for line in certificate["lines"]:
        if line["verdict"] != "pass":
            yield f"{line['name']}: {line['verdict']}{'; ' + line['note'] if line['note'] else ''}"
    estimate = certificate.get("estimate") or {}
    if omission := estimate.get("without_geometry"):
        yield f"The estimated error leaves out the error of the geometry: {omission}."
    for name in estimate.get("unreliable") or ():
        yield f"The estimated error of '{name}' is not reliable."
    yield from ((summary.get("body") or {}).get("warnings")) or ()
    if not summary.get("sensitivities"):
        yield "Sensitivities to properties and loads were not computed (section 'sensitivities' of the job)."
    if not summary.get("surface_errors"):
        yield "Effects of errors of the given surface were not computed (mesh.surface_error, or an image)."


def _hashes(directory: Path) -> Iterator[tuple[str, str]]:
    """Yield name and SHA-256 of the files of a run that decide about it, and of its shapes."""
    for path in sorted(directory.iterdir()):
        if path.is_file() and path.suffix in (*FORMATS, ".yaml", ".json", ".h5", ".npz", ".log"):
            try:
                with admitted(path).open("rb") as file:
                    yield path.name, hashlib.file_digest(file, "sha256").hexdigest()
            except OSError as error:
                raise OutputError(f"{path}: cannot be read: {error.strerror}") from error
