"""Sweeps under a real Slurm, by ``sweep submit``: arrays, time limits, scancel, and the table at the end."""

from __future__ import annotations

import csv
import re
import sys
from pathlib import Path
from subprocess import CompletedProcess

import pytest
import yaml
from helpers.batch import Batch
from helpers.command_line import BLOCK

pytestmark = pytest.mark.slurm

CASES = 8
# So that each takes a second or more.
JOB = {**BLOCK, "solver": {"strategy": "fixed", "steps": 100}}
AXES = [{"grid": {"material.mu": [10e3 + 100 * i for i in range(CASES)]}}]


def submit(batch: Batch, *words: object) -> CompletedProcess[str]:
    (batch.place / "block.yaml").write_text(yaml.safe_dump(JOB))
    (batch.place / "stiffness.yaml").write_text(yaml.safe_dump({"job": "block.yaml", "axes": AXES}))
    return batch.run(sys.executable, "-m", "hpcinv", "sweep", "submit", "stiffness.yaml", *words)


def submitted(batch: Batch, *words: object) -> tuple[str, str]:
    """The job that runs the sweep, and the one that collects."""
    done = submit(batch, *words)
    assert done.returncode == 0, done.stderr
    run, collect = batch.watch(done.stdout)
    return run, collect


def logs(batch: Batch) -> list[Path]:
    return sorted(batch.place.glob("results/stiffness/slurm/run-*.out"))


def solved(log: Path) -> list[int]:
    return [int(number) for number in re.findall(r"case (\d+), ", log.read_text())]


def assert_collected(batch: Batch, collect: str) -> None:
    """The last job has written a table of all cases, and each was solved in one place only."""
    assert {fact["JobState"] for fact in batch.wait(collect)} == {"COMPLETED"}, batch.outputs()
    with (batch.place / "results" / "stiffness" / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["status"] for row in rows] == ["converged"] * CASES
    tops = [float(row["top [mm]"]) for row in rows]
    assert tops == sorted(tops)  # the stiffer the block, the less is it pressed down
    assert max(tops) < 0.0
    assert sorted(case for log in logs(batch) for case in solved(log)) == list(range(CASES)), batch.outputs()
    assert (batch.place / "results" / "stiffness" / "table.h5").exists()


@pytest.mark.usefixtures("limited")
def test_tasks_of_an_array_share_the_cases_and_one_of_them_is_requeued_alone(batch: Batch) -> None:
    run, collect = submitted(batch, "--ntasks", 1, "--array", 2, "--time", 5, "--lead", 30)
    batch.until(lambda: len(logs(batch)) == 2 and all(map(solved, logs(batch))))
    (last,) = (fact["JobId"] for fact in batch.facts(run) if fact["ArrayTaskId"] == "2")
    assert last == run  # Slurm gives the last task the array's own id
    assert batch.run("scancel", "--signal=USR1", "--batch", f"{run}_2").returncode == 0
    tasks = {fact["ArrayTaskId"]: (fact["JobState"], fact["Restarts"]) for fact in batch.wait(run)}
    assert tasks == {"1": ("COMPLETED", "0"), "2": ("COMPLETED", "1")}, batch.outputs()
    assert "has saved its state, and is requeued to go on" in batch.outputs()
    assert_collected(batch, collect)


@pytest.mark.release
def test_a_sweep_that_is_stopped_ahead_of_its_limit_goes_on_when_it_is_requeued(batch: Batch) -> None:
    run, collect = submitted(batch, "--ntasks", 2, "--time", 5, "--lead", 30)
    batch.wait_for("case ", run)
    assert batch.run("scancel", "--signal=USR1", "--batch", run).returncode == 0
    (facts,) = batch.wait(run)
    assert (facts["JobState"], facts["Restarts"]) == ("COMPLETED", "1"), batch.outputs()
    assert f"job {run}: has saved its state, and is requeued to go on" in batch.outputs()
    assert_collected(batch, collect)


@pytest.mark.release
def test_a_cancelled_sweep_is_not_requeued_and_goes_on_when_it_is_submitted_again(batch: Batch) -> None:
    first, collect = submitted(batch, "--ntasks", 2)
    batch.wait_for("case ", first)
    assert batch.run("scancel", first).returncode == 0
    batch.wait(collect)
    again, collect = submitted(batch, "--ntasks", 2)
    assert {fact["JobState"] for fact in batch.wait(again)} == {"COMPLETED"}, batch.outputs()
    assert_collected(batch, collect)
    (facts,) = batch.facts(first)
    assert (facts["JobState"], facts["Restarts"]) == ("CANCELLED", "0")


def test_refusals_of_sbatch_are_quoted(batch: Batch) -> None:
    done = submit(batch, "--ntasks", 1, "--sbatch", "partition=nowhere")
    assert done.returncode == 2
    assert "sbatch refuses results/stiffness/slurm/run.sbatch" in done.stderr
    assert "invalid partition specified: nowhere" in done.stderr
