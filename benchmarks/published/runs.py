"""Runs of the jobs of a source; a finished one is kept in the store and is not solved again.

A folder may have a module ``cases.py`` with one or both of

- ``job_file(name, store)``: the job file of that name, made on rank 0 from files that the user has; raises `Missing`;
- ``quantities(name, result)``: further quantities (SI) of a run, by name; collective.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import hpcinv
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.quantity.keys import assigned
from hpcinv.errors import HpcinvError
from hpcinv.job.fingerprint import content_key
from hpcinv.job.job import Job, parse
from hpcinv.job.yaml_reader import read_yaml

from .references import FOLDER, PublishedValue

_WITHOUT_ESTIMATE: dict[str, Any] = {"certificate": "quick"}  # finer meshes need none
SUMMARY, BODY, QUANTITIES = "summary.json", "shape.msh", "quantities.json"


class Missing(HpcinvError):
    """Files that the user must have are not there; the message says which, and how to name their place."""


def summary_of(row: PublishedValue, store: Path, comm: MPI.Intracomm) -> Mapping[str, Any]:
    """Return ``summary.json`` of the run that a row needs, which is solved unless the store has it; collective.

    ``finer`` in it has the summaries on the finer meshes of the row. A run that fails gives ``{"failure": message}``,
    one whose files are missing ``{"missing": message}``.
    """
    try:
        changes = dict(row.changes)
        if row.loaded:
            loaded = _solved(row, row.loaded, changes | {"output.mesh": ["msh"]}, store, comm, BODY)
            changes = {key: value for key, value in changes.items() if not key.startswith("mesh.")}
            changes["mesh.file"] = str((loaded / BODY).resolve())
        directory = _solved(row, row.job, changes, store, comm)
        finer = [_solved(row, row.job, changes | _WITHOUT_ESTIMATE | dict(mesh), store, comm) for mesh in row.finer]
    except Missing as error:
        return {"missing": error.message}
    except HpcinvError as error:
        return {"failure": str(error).splitlines()[0]}
    summary: dict[str, Any] = on_root(comm, lambda: _summary(directory))
    summary["finer"] = on_root(comm, lambda: [_summary(mesh) for mesh in finer])
    return summary


def _summary(directory: Path) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((directory / SUMMARY).read_text())
    if (directory / QUANTITIES).exists():
        summary["quantities"] |= json.loads((directory / QUANTITIES).read_text())
    return summary


def _cases(folder: str) -> ModuleType | None:
    """Return the module ``cases.py`` of a folder, if it has one."""
    name = f"{__package__}.{folder}.cases"
    return importlib.import_module(name) if (FOLDER / folder / "cases.py").exists() else None


def _job(row: PublishedValue, name: str, changes: Mapping[str, Any], store: Path) -> Job:
    path = FOLDER / row.folder / f"{name}.yaml"
    if not path.exists() and (cases := _cases(row.folder)):
        path = cases.job_file(name, store)
    return parse(assigned(read_yaml(path), changes), path)


def _solved(
    row: PublishedValue, name: str, changes: Mapping[str, Any], store: Path, comm: MPI.Intracomm, file: str = SUMMARY
) -> Path:
    """Return the directory of the finished run of a job, with a file that it must hold; collective."""
    store = store / row.folder
    job = on_root(comm, lambda: _job(row, name, changes, store))
    directory = store / f"{job.job}-{on_root(comm, lambda: content_key(job))[:12]}"
    if not on_root(comm, lambda: (directory / file).exists() and (directory / SUMMARY).exists()):
        result = hpcinv.run(job, comm, directory=directory, overwrite=True)
        if (cases := _cases(row.folder)) and hasattr(cases, "quantities"):
            own = cases.quantities(name, result)
            on_root(comm, lambda: (directory / QUANTITIES).write_text(json.dumps(own)))
    return directory
