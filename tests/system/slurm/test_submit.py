"""``sweep submit`` where nothing is submitted: scripts, and what is refused before."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from helpers.command_line import CUBE, ROOT, environment

SLURM = ROOT / "slurm"


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    """A sweep file whose path has a space."""
    directory = tmp_path / "my sweeps"
    directory.mkdir()
    (directory / "cube.yaml").write_text(yaml.safe_dump(dict(CUBE)))
    path = directory / "cubes.yaml"
    axes = [{"grid": {"material.young": ["1 MPa", "2 MPa"]}}]
    path.write_text(yaml.safe_dump({"job": "cube.yaml", "store": "store", "axes": axes}))
    return path


def submit(sweep: Path, *words: object, path: str | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hpcinv", "sweep", "submit", str(sweep.relative_to(sweep.parents[1]))]
    return subprocess.run(
        [*command, *map(str, words)],
        cwd=sweep.parents[1],
        env=environment(PATH=path or os.environ["PATH"]),
        capture_output=True,
        text=True,
        check=False,
    )


def options(script: Path) -> dict[str, str]:
    """Of a batch script; of those that stand twice the last, as sbatch takes them."""
    lines = (line.removeprefix("#SBATCH --") for line in script.read_text().splitlines() if line.startswith("#SBATCH"))
    return dict(line.partition("=")[::2] for line in lines)


def test_a_dry_run_writes_and_shows_the_scripts(sweep: Path) -> None:
    words = ["--ntasks", 4, "--ranks-per-case", 2, "--time", "01:00:00", "--lead", 300, "--sbatch", "account=soft"]
    done = submit(sweep, *words, "--dry-run")
    assert done.returncode == 0, done.stderr
    place = sweep.parents[1] / "results" / "cubes" / "slurm"
    run, collect = place / "run.sbatch", place / "collect.sbatch"
    assert options(run) == {
        "job-name": "cubes",
        "output": "results/cubes/slurm/run-%j.out",
        "ntasks": "4",
        "time": "01:00:00",
        "signal": "B:USR1@300",
        "account": "soft",
        "requeue": "",
        "open-mode": "append",
    }
    assert {"account": "soft", "ntasks": "1"}.items() <= options(collect).items()
    for script in (run, collect):
        assert script.read_text() in done.stdout
    # What the template runs, with a launcher that shows it.
    shown = subprocess.run(
        ["bash", str(run)],
        cwd=sweep.parents[1],
        env=environment(HPCINV_LAUNCHER="printf <%s>", SLURM_NTASKS="4", SLURM_JOB_ID="1"),
        capture_output=True,
        text=True,
        check=True,
    )
    words = ["python", "-m", "hpcinv", "sweep", "run", "my sweeps/cubes.yaml", "--ranks-per-case", "2", "--ranks", "4"]
    assert shown.stdout == "".join(f"<{word}>" for word in words)


def test_an_array_is_asked_for(sweep: Path) -> None:
    assert submit(sweep, "--ntasks", 1, "--array", 3, "--dry-run").returncode == 0
    run = sweep.parents[1] / "results" / "cubes" / "slurm" / "run.sbatch"
    assert options(run)["array"] == "1-3"
    assert options(run)["output"].endswith("run-%A_%a.out")


def test_tasks_of_an_array_begin_with_different_shares() -> None:
    script = (SLURM / "sweep-array.sbatch").read_text()
    shares = set()
    for task in range(1, 4):
        variables = {"SLURM_ARRAY_TASK_ID": str(task), "SLURM_ARRAY_TASK_COUNT": "3", "SLURM_NTASKS": "1"}
        done = subprocess.run(
            ["bash", "-s", "x.yaml"],
            input=script,
            env=environment(HPCINV_LAUNCHER="echo", SLURM_JOB_ID="1", **variables),
            capture_output=True,
            text=True,
            check=True,
        )
        shares.add(done.stdout.split()[-1])
    assert shares == {"1/3", "2/3", "3/3"}


def test_missing_slurm_is_reported(sweep: Path, tmp_path: Path) -> None:
    done = submit(sweep, "--ntasks", 2, path=str(tmp_path))
    assert done.returncode == 2
    assert done.stderr.startswith("the command sbatch of Slurm was not found")
    assert "Traceback" not in done.stderr


@pytest.mark.everyday("words1---ranks-per-case 0", "words3---time 1:00: is not above the 60 s that are kept")
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--ntasks", 3, "--ranks-per-case", 2], "3 ranks cannot be divided into groups of that size"),
        (["--ntasks", 3, "--ranks-per-case", 0], "--ranks-per-case 0"),
        (
            ["--ntasks", 1, "--time", "2"],
            "--time 2: is not above the 120 s that are kept for saving",
        ),
        (["--ntasks", 1, "--time", "1:00", "--lead", 60], "--time 1:00: is not above the 60 s that are kept"),
        (["--ntasks", 1, "--time", "0-1", "--lead", 3600], "--time 0-1: is not above the 3600 s that are kept"),
    ],
)
def test_impossible_requests_are_refused(words: list[object], message: str, sweep: Path) -> None:
    done = submit(sweep, *words)
    assert done.returncode == 2
    assert message in done.stderr


@pytest.mark.release
@pytest.mark.parametrize("limit", ["3", "2:01", "0:02:01", "1-0", "0-00:02:01", "UNLIMITED"])
def test_time_limits_above_the_lead_are_taken(limit: str, sweep: Path) -> None:
    done = submit(sweep, "--ntasks", 1, "--time", limit, "--dry-run")
    assert done.returncode == 0, done.stderr


def test_a_store_that_cannot_be_used_is_reported_before_anything_is_submitted(sweep: Path) -> None:
    (sweep.parent / "store").write_text("a file")
    done = submit(sweep, "--ntasks", 1, "--dry-run")
    assert done.returncode == 2
    assert "store" in done.stderr
    assert not (sweep.parents[1] / "results").exists()


def test_every_script_is_in_order() -> None:
    scripts = sorted(SLURM.iterdir())
    assert [script.name for script in scripts if script.suffix == ".sbatch"] == [
        "collect.sbatch",
        "job.sbatch",
        "sweep-array.sbatch",
        "sweep.sbatch",
    ]
    for script in scripts:
        subprocess.run(["bash", "-n", str(script)], check=True)
