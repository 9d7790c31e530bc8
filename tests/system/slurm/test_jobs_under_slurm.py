"""Single jobs under a real Slurm: preemption, scancel and resume, launchers; as a user types it."""

from __future__ import annotations

import json

import pytest
from helpers.batch import Batch
from helpers.cluster import CPUS
from helpers.slow_jobs import JOB, assert_finished, submit_slowly, write

pytestmark = pytest.mark.slurm


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
