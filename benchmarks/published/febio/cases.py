"""Jobs from files of FEBio's test suite, in the clone that ``HPCINV_FEBIO_TESTS`` names, and its number of a test."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hpcinv.base.parallel.runtime import on_root
from hpcinv.errors import JobError
from hpcinv.formats.cards.card import CardError
from hpcinv.mesh.body import reorder_to_source

from ..runs import Missing
from .conversion import Unsupported, convert, prescribed
from .feb_reader import FebError, Model, read_feb

if TYPE_CHECKING:
    from hpcinv.output.result import Result

FOLDER = "HPCINV_FEBIO_TESTS"
UNLOADED = "-unloaded"
"""End of the name of an inverse job."""


@cache
def _model(test: str) -> Model:
    folder = os.environ.get(FOLDER)
    if folder is None:
        raise Missing(f"FEBio's test suite is not here: set {FOLDER} to a clone of febiosoftware/TestSuite")
    path = Path(folder) / "Verify" / f"{test}.feb"
    if not path.exists():
        raise Missing(f"{path} is missing ({FOLDER})")
    return read_feb(path)


def job_file(name: str, store: Path) -> Path:
    """Write mesh and job of a test, such as ``ma48``, or backwards ``ma48-unloaded``; return the job's file.

    Raises:
        Missing: the file is not there.
        JobError: it cannot be read, or has no counterpart.
    """
    test, analysis = name.removesuffix(UNLOADED), "inverse" if name.endswith(UNLOADED) else "forward"
    try:
        conversion = convert(_model(test), name, analysis)
    except (FebError, Unsupported, CardError) as error:
        raise JobError(f"{test}.feb: {error}") from error
    return conversion.write(store / "jobs" / name)


def quantities(name: str, result: Result) -> dict[str, float]:
    """Return the norm of the displacements that are not prescribed, or of an inverse job the radius of the body (m).

    The radius is the root of the mean square of the distances of its nodes from the origin. Collective.
    """
    if (Path(__file__).parent / f"{name}.yaml").exists():
        return {}  # a job of this folder, with quantities of its own
    body, solution = result.body, result.solutions[0]
    nodes, moves = reorder_to_source(body, solution.other_nodes), reorder_to_source(body, solution.u)

    def evaluate() -> dict[str, float]:
        if name.endswith(UNLOADED):
            return {"radius": float(np.sqrt((nodes**2).sum(axis=1).mean()))}
        free = np.ones_like(moves, dtype=bool)
        row = {int(tag): i for i, tag in enumerate(body.source.node_tags)}
        for node, axis in prescribed(_model(name)):
            if node in row:
                free[row[node], axis] = False
        return {"norm": float(np.linalg.norm(moves[free]))}

    return on_root(body.mesh.comm, evaluate)
