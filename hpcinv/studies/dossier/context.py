"""The context file of a dossier, which states what only the applicant knows, and its template."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

from hpcinv.base.quantity.docstrings import meanings
from hpcinv.base.quantity.schema import ListOf, Spec
from hpcinv.pages.reports.page import number
from hpcinv.studies.batch.specification import read_spec

OPEN = "to be filled by the applicant"

type Grade = Literal["", "low", "medium", "high"]


class Evidence(Spec):
    """A comparison of the model with an experiment or with clinical data."""

    activity: str
    """what was compared: samples or patients, conditions, measured quantity"""
    agreement: str
    """result of the comparison, with uncertainties"""
    relevance: str
    """why it holds for the context of use"""


class DossierContext(Spec):
    """Context file of a dossier; what it leaves out is marked in the dossier."""

    title: str = ""
    """title of the dossier"""
    product: str = ""
    """device, procedure or product"""
    author: str = ""
    """person or organisation that is responsible"""
    question: str = ""
    """question of interest: the decision that the simulation supports"""
    context_of_use: str = ""
    """role and scope of the simulation in that decision, with other evidence"""
    influence: Grade = ""
    """influence of the simulation on the decision: low, medium or high"""
    influence_reason: str = ""
    """reason for the influence"""
    consequence: Grade = ""
    """consequence of a wrong decision: low, medium or high"""
    consequence_reason: str = ""
    """reason for the consequence"""
    required_accuracy: str = ""
    """error of each quantity that the decision allows"""
    geometry: str = ""
    """source of the geometry: scan, protocol, resolution, segmentation, or drawing"""
    sources: Mapping[str, str] = {}
    """source of each material property and load, by its key, such as material.mu"""
    boundary_conditions: str = ""
    """why supports and loads represent the context of use"""
    validation: ListOf[Evidence] = ()
    """comparisons with experiments or clinical data"""
    limits: ListOf[str] = ()
    """further limits of the model"""


class _Named(DossierContext):
    dossier: str = ""
    """name of the dossier; left out, the name of the file"""


def read_context(path: Path) -> DossierContext:
    """Read a context file.

    Raises:
        JobError: with a line for each fault.
    """
    return read_spec(_Named, "dossier", path, untrusted=True)


def template(properties: Mapping[str, Any]) -> str:
    """Return a context file to be filled, with a line for each property that needs a source."""
    return "\n".join(_lines(properties)) + "\n"


def _lines(properties: Mapping[str, Any]) -> Iterator[str]:
    yield "# Context of a dossier. Fill in the texts; what stays empty is marked in the dossier."
    for name, text in meanings(DossierContext).items():
        yield f"# {' '.join(text.split())}"
        match name:
            case "sources":
                yield "sources:" if properties else "sources: {}"
                yield from (f'  {json.dumps(key)}: ""  # {number(value)}' for key, value in properties.items())
            case "validation":
                yield "validation: []"
                yield from (f"#  {'- ' if n == 0 else '  '}{key}: …" for n, key in enumerate(meanings(Evidence)))
            case "limits":
                yield "limits: []"
            case _:
                yield f'{name}: ""'
