"""Fingerprint of the physics of a job, differences of fingerprints, and the content key of a run."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from hpcinv.base.quantity.schema import KeyPath, dotted_key
from hpcinv.errors import CheckpointError
from hpcinv.job.job import Job
from hpcinv.job.resolved_job import ENTRIES, EntryTexts, SectionData, resolved, without

FORMAT = 2
"""of fingerprints: raised if they have more or less of a job, so that earlier ones are refused by one message"""

NOT_CONTENT: dict[str, str] = {
    "job": "names the results",
    "let": "is in the formulas that use it",
    "first": "is in 'directions'",
    "output": "chooses what is written of the same results",
    "checkpoint": "chooses when states are saved",
    "identify": "is read by 'identify' only, which adds it to its keys",
    "mesh.partition": "divides the cells among ranks; results are in the order of the file",
}
"""What has no influence on the content key of a run, with the reason."""

NOT_PHYSICS: dict[str, str] = NOT_CONTENT | {
    "solver": "chooses the way to a state, which a resume may change",
    "method": "chooses the way to a state",
    "fixed_point": "chooses the way to a state",
    "certificate": "chooses checks of solved states",
    "second_opinion": "is of what a run has written",
    "quantities": "are evaluated at solved states",
    "sensitivities": "are derivatives at solved states; the layers that they make are in 'discretisation'",
    "accuracy": "chooses mesh and spaces; a search begins again",
    "expected_shape": "is compared with solved shapes",
    "mesh.maximum_cells": "stops the meshing of too many cells",
    "mesh.surface_error": "is for the certificate",
}
"""What has no influence on the fingerprint of the physics, with the reason."""


def fingerprint(job: Job, known: SectionData | None = None) -> dict[str, Any]:
    """The physics of a job as JSON data, with automatic choices resolved and files by their SHA-256."""
    return {"format": FORMAT} | resolved(job, NOT_PHYSICS, known)


def content_key(job: Job, known: SectionData | None = None, **circumstances: Any) -> str:
    """Hash (20 hex digits) of all that the results of a job depend on: everything except `NOT_CONTENT`.

    Paths of files and the units of values have no influence.

    Args:
        known: data of sections of earlier jobs of the same file.
        circumstances: further data that distinguish runs, as JSON data, such as ``ranks``.
    """
    content = (known or SectionData()).joined(job, _CONTENT)
    return hash_of_text(f"[{content}, {json.dumps(circumstances) if circumstances else '{}'}]")


def entry_texts(left_out: Mapping[str, str]) -> Iterator[tuple[str, Callable[[SectionData, Job], str]]]:
    """Yield the entries of a resolved job, and their JSON texts; empty if the job does not have one."""
    for name in ENTRIES:
        if name not in left_out:
            yield name, partial(_entry_text, name, [key for key in left_out if key.startswith(f"{name}.")])


def _entry_text(name: str, left_out: Sequence[str], known: SectionData, job: Job) -> str:
    entry = known.entry(job, name)
    if entry is not None and left_out:
        entry = without(name, entry, left_out)
    return "" if entry is None else json.dumps(entry)


_CONTENT = EntryTexts(*entry_texts(NOT_CONTENT))


def hash_of(content: Any) -> str:
    """Hash (20 hex digits) of JSON data; the order of names counts, as of the layers of a shell."""
    return hash_of_text(json.dumps(content))


def hash_of_text(text: str) -> str:
    """Hash (20 hex digits) of JSON text, as `json.dumps` writes it."""
    return hashlib.sha256(text.encode()).hexdigest()[:20]


def difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """One line such as ``material.c1: 101709.7 -> 99999.0`` for each difference between two fingerprints."""
    a, b = dict(_leaves(old, ())), dict(_leaves(new, ()))
    lines = [
        f"{dotted_key(where)}: {a.get(where, 'absent')} -> {b.get(where, 'absent')}"
        for where in {**a, **b}
        if a.get(where, _ABSENT) != b.get(where, _ABSENT)
    ]
    if not lines and (where := _reordered(old, new, ())) is not None:
        lines = [f"{dotted_key(where)}: has another order"]
    return lines


def check_same_problem(path: Path, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    """Raise ``CheckpointError`` with the differences, if what is in ``path`` has another fingerprint than a job."""
    if old.get("format") != new.get("format"):
        raise CheckpointError(
            f"{path}: was written by a version of hpcinv that compares jobs by less than this one",
            "Start the job again with 'run', or resume it with the version that wrote it.",
        )
    if changes := difference(old, new):
        raise CheckpointError(
            "\n".join([f"{path}: belongs to another problem:", *(f"  {line}" for line in changes)]),
            "A resume may change solver, output and checkpoint settings, but not the physics; use 'run' for that.",
        )


_ABSENT = object()


def _leaves(data: Any, where: KeyPath) -> Iterator[tuple[KeyPath, Any]]:
    if isinstance(data, Mapping):
        for key, value in data.items():
            yield from _leaves(value, (*where, key))
    elif isinstance(data, Sequence) and not isinstance(data, str):
        for i, value in enumerate(data):
            yield from _leaves(value, (*where, i))
    else:
        yield where, data


def _reordered(old: Any, new: Any, where: KeyPath) -> KeyPath | None:
    """Return the place of the first mapping with another order, of data with the same leaves."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        if list(old) != list(new):
            return where
        pairs: list[tuple[str | int, Any, Any]] = [(key, old[key], new[key]) for key in old]
    elif isinstance(old, list) and isinstance(new, list):
        pairs = [(i, *pair) for i, pair in enumerate(zip(old, new, strict=False))]
    else:
        return None
    places = (_reordered(a, b, (*where, key)) for key, a, b in pairs)
    return next((place for place in places if place is not None), None)
