"""What tests of second opinions share: a soft block, its run, and how far CalculiX is from it."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

import hpcinv
from helpers.verification import job
from hpcinv.__main__ import main
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import Job, load
from hpcinv.studies.second_opinion.opinion import second_opinion

needs_calculix = pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
BLOCK: dict[str, Any] = {
    "analysis": "inverse",
    "mesh": {"file": "../meshes/box.py", "parameters": {"lx": 0.1, "ly": 0.1, "lz": 0.2, "nx": 2, "ny": 2, "nz": 2}},
    "material": {"law": "isochoric-neo-hookean", "mu": 1e4, "kappa": 4e4},
    "discretisation": {"displacement": 1, "formulation": "displacement"},
    "effects": [
        {"effect": "gravity", "acceleration": [1, 0, -2], "density": 1000},
        {"effect": "traction", "region": "z1", "traction": [200, 300, 100], "area_in": "reference"},
    ],
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
    "output": {"mesh": ["msh"], "fields": False},
}
LOST = 1e-4
"""Distance by lost digits, relative to the displacement: the file of CalculiX has 7, and residuals end at 1e-6."""


def solved(directory: Path, **data: Any) -> Path:
    """Solve the block with other sections, and return the directory of its run."""
    hpcinv.run(job(**BLOCK | data), MPI.COMM_SELF, directory=directory / "run", progress=False)
    return directory / "run"


def distance(run: Path) -> float:
    """Return how far CalculiX's body is from the given one, relative to the largest displacement."""
    opinion = second_opinion(run, None, 120)
    print(f"{opinion.element}: {opinion.largest:.2e} m of {opinion.displacement:.2e} m")
    assert opinion.displacement > 1e-3
    return opinion.largest / opinion.displacement


def job_of_deck(run: Path, directory: Path) -> tuple[Job, str]:
    """Write the deck of a run for Abaqus, and return the job that is read from it, and its text."""
    deck, path = directory / "part.inp", directory / "back.yaml"
    assert main(["export", str(run), "--deck", str(deck), "--for", "abaqus", "--unit", "mm"]) == 0
    assert main(["new", "job", "--from", str(deck), "--unit", "mm", "--stress-unit", "MPa", str(path)]) == 0
    return load(path), path.read_text()


def reaches_given_body(run: Path, again: Job, **data: Any) -> float:
    """Return how far a job of a deck is from the given body, relative to the largest displacement."""
    from hpcinv.geometry.workshop.run_shapes import read_shape

    rest, given = (read_shape(run, shape).points for shape in ("undeformed", "deformed"))
    changes = {"discretisation": BLOCK["discretisation"], "certificate": "off", **data}
    loaded = hpcinv.run(again.with_(changes), MPI.COMM_SELF, progress=False)
    distances, rows = cKDTree(rest).query(loaded.given_in_file)
    assert distances.max() < 1e-8
    return float(np.abs(loaded.shape_in_file - given[rows]).max() / np.abs(given - rest).max())
