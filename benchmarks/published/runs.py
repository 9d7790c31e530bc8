"""Runs of the jobs of a source; a finished one is kept in the store and is not solved again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import hpcinv
from hpcinv.errors import HpcinvError
from hpcinv.job.fingerprint import content_key
from hpcinv.job.job import Job, parse
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.parallel.runtime import MPI, on_root
from hpcinv.quantity.keys import assigned

from .references import FOLDER, Reference

SUMMARY, BODY = "summary.json", "shape.msh"


def summary_of(row: Reference, store: Path, comm: MPI.Intracomm) -> Mapping[str, Any]:
    """Return ``summary.json`` of the run that a row needs, which is solved unless the store has it; collective.

    A run that fails gives ``{"failure": message}``.
    """
    try:
        changes = dict(row.changes)
        if row.loaded:
            loaded = _solved(_job(row, row.loaded, changes | {"output.mesh": ["msh"]}), store / row.folder, comm, BODY)
            changes = {key: value for key, value in changes.items() if not key.startswith("mesh.")}
            changes["mesh"] = {"file": str((loaded / BODY).resolve())}
        directory = _solved(_job(row, row.job, changes), store / row.folder, comm)
    except HpcinvError as error:
        return {"failure": str(error).splitlines()[0]}
    summary: Mapping[str, Any] = on_root(comm, lambda: json.loads((directory / SUMMARY).read_text()))
    return summary


def _job(row: Reference, name: str, changes: Mapping[str, Any]) -> Job:
    path = FOLDER / row.folder / f"{name}.yaml"
    return parse(assigned(read_yaml(path), changes), path)


def _solved(job: Job, store: Path, comm: MPI.Intracomm, file: str = SUMMARY) -> Path:
    """Return the directory of the finished run of a job, with a file that it must hold; collective."""
    directory = store / f"{job.job}-{on_root(comm, lambda: content_key(job))[:12]}"
    if not on_root(comm, lambda: (directory / file).exists() and (directory / SUMMARY).exists()):
        hpcinv.run(job, comm, directory=directory, overwrite=True)
    return directory
