"""Single jobs under a real Slurm: time limit and requeue, scancel and resume, launchers; as a user types it."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from helpers.batch import Batch
from helpers.cluster import CPUS
from helpers.command_line import CUBE, ROOT, write_job

pytestmark = pytest.mark.slurm

JOB = ROOT / "slurm" / "job.sbatch"
# Of the sheared unit cube: mu/2 k², with k = 0.1.
STRAIN_ENERGY = 1e6 / 2.6 / 2 * 0.1**2


def write(path: Path, steps: int) -> None:
    write_job(path, CUBE, solver={"strategy": "fixed", "steps": steps}, output={"fields": False, "mesh": []})


def submit_slowly(batch: Batch, *words: object, **env: str) -> str:
    """Start a job of thousands of steps on two ranks; when it is resumed, it will take large ones."""
    write(batch.place / "cube.yaml", 10_000)
    job = batch.sbatch("--ntasks=2", *words, JOB, "cube.yaml", "cube", **env)
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


def test_at_its_time_limit_a_job_saves_its_state_and_is_requeued_until_it_is_done(batch: Batch) -> None:
    job = submit_slowly(batch, "--time=1", "--signal=B:USR1@45")
    batch.wait(job)
    (facts,) = batch.facts(job)
    assert facts["JobState"] == "COMPLETED", batch.outputs()
    assert int(facts["Restarts"]) >= 1
    assert "stopped by a signal" in batch.outputs()
    assert f"job {job}: has saved its state, and is requeued to go on" in batch.outputs()
    assert len(assert_finished(batch.place / "cube")) < 10_000


@pytest.mark.release
def test_a_job_that_cannot_save_before_its_time_limit_ends_after_two_requeues(batch: Batch) -> None:
    """A run that takes longer to its first load step than Slurm gives it; a script stands for it."""
    (batch.place / "slow.sh").write_text("trap 'exit 75' USR1\nwhile :; do sleep 0.1; done\n")
    write(batch.place / "cube.yaml", 1)
    launcher = {"HPCINV_LAUNCHER": "bash slow.sh"}
    job = batch.sbatch("--ntasks=1", "--time=1", "--signal=B:USR1@600", JOB, "cube.yaml", "cube", **launcher)
    batch.until(lambda: batch.facts(job)[0]["Restarts"] != "0")  # each time the signal comes after up to a minute
    (facts,) = batch.wait(job)
    assert (facts["JobState"], facts["ExitCode"], facts["Restarts"]) == ("FAILED", "75:0", "2"), batch.outputs()
    assert "has saved its state" not in batch.outputs()
    assert f"job {job}: not requeued any more: three times in a row" in batch.outputs()
    assert "is not above the 120 s that are kept" in batch.outputs()  # of the script: sbatch was given another one


@pytest.mark.release
def test_a_job_that_is_preempted_saves_its_state_and_goes_on_afterwards(batch: Batch) -> None:
    job = submit_slowly(batch)
    urgent = batch.sbatch("--ntasks", CPUS, "--partition=urgent", "--wrap=true")
    assert {fact["JobState"] for fact in batch.wait(urgent)} == {"COMPLETED"}
    (facts,) = batch.wait(job)
    assert (facts["JobState"], facts["Restarts"]) == ("COMPLETED", "1"), batch.outputs()
    assert "its state is saved" in batch.outputs()
    assert_finished(batch.place / "cube")


@pytest.mark.release
def test_a_cancelled_job_can_be_resumed_and_is_not_requeued(batch: Batch) -> None:
    srun = {"HPCINV_LAUNCHER": "srun --mpi=pmi2"}
    job = submit_slowly(batch, **srun)
    assert batch.run("scancel", job).returncode == 0
    batch.wait(job)
    assert "its state is saved" in batch.outputs()
    assert json.loads((batch.place / "cube" / "summary.json").read_text())["status"] == "stopped by a signal"
    again = batch.sbatch("--ntasks=2", JOB, "cube.yaml", "cube", **srun)
    batch.wait(again)
    assert batch.states(again) == {"COMPLETED"}, batch.outputs()
    assert_finished(batch.place / "cube")
    (facts,) = batch.facts(job)
    assert (facts["JobState"], facts["Restarts"]) == ("CANCELLED", "0")


def test_a_launcher_that_starts_single_ranks_is_refused(batch: Batch) -> None:
    write(batch.place / "cube.yaml", 1)
    job = batch.sbatch("--ntasks=2", JOB, "cube.yaml", HPCINV_LAUNCHER="srun --mpi=none")
    (facts,) = batch.wait(job)
    assert (facts["JobState"], facts["ExitCode"]) == ("FAILED", "2:0")
    assert "--ranks 2 was requested, but the launcher started 1" in batch.outputs()
    assert not list(batch.place.glob("results/*"))
