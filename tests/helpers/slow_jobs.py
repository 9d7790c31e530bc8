"""Jobs of thousands of steps under Slurm, which something ends on their way, and that take large steps afterwards."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from helpers.batch import Batch
from helpers.command_line import CUBE, ROOT, write_job

JOB = ROOT / "slurm" / "job.sbatch"
# Of the sheared unit cube: mu/2 k², with k = 0.1.
STRAIN_ENERGY = 1e6 / 2.6 / 2 * 0.1**2


def write(path: Path, steps: int) -> None:
    write_job(path, CUBE, solver={"strategy": "fixed", "steps": steps}, output={"fields": False, "mesh": []})


def submit_slowly(batch: Batch, *words: object, **env: str) -> str:
    """Start a job of thousands of steps on two ranks, at a low priority; a resume takes large steps."""
    write(batch.place / "cube.yaml", 10_000)
    job = batch.submit("nice", "-n", 5, "sbatch", "--ntasks=2", *words, JOB, "cube.yaml", "cube", **env)
    batch.wait_for("  load 0.0002:", job)
    write(batch.place / "cube.yaml", 10)
    return job


def assert_finished(run: Path) -> list[float]:
    """The result equals an uninterrupted run's, and no step was taken twice; return all loads."""
    summary: dict[str, Any] = json.loads((run / "summary.json").read_text())
    (solution,) = summary["solutions"]
    loads = [solve["load"] for solve in solution["solves"]]
    assert summary["status"] == "converged"
    assert summary["machine"]["ranks"] == 2
    assert solution["strain_energy"] == pytest.approx(STRAIN_ENERGY, rel=1e-12)
    assert all(earlier < later for earlier, later in pairwise(loads))
    assert loads[:2] == [1e-4, 2e-4]
    assert loads[-1] == 1.0
    return loads
