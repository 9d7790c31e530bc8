"""What the batch scripts share, without Slurm: passing signals on, and which ends put a job back into the queue."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
from helpers.command_line import ROOT

TASK = {"SLURM_ARRAY_JOB_ID": "17", "SLURM_ARRAY_TASK_ID": "4"}
# Stands for a parallel run: notes the signals that it gets, and ends when it has got enough of them.
RUN = """
[ -z "$SAVES" ] || touch "$HPCINV_SAVED"
trap 'echo USR1 >>got' USR1
trap 'echo TERM >>got' TERM
touch ready
until [ -e got ] && [ "$(wc -l <got)" -ge "$1" ]; do sleep 0.02; done
exit "$2"
"""
# Notes what it is asked to do.
SCONTROL = """#!/bin/sh
if [ "$1" = show ]; then echo "TimeLimit=${LIMIT:-UNLIMITED} PreemptTime=${PREEMPTED:-None}"; else echo "$@" >>asked; fi
"""


def launched(place: Path, code: int, *signals: signal.Signals, **variables: str) -> tuple[int, str]:
    """Send signals to a batch script, whose run then ends with a code; its own exit code, and what it has requeued."""
    (place / "run.sh").write_text(RUN)
    scontrol = place / "scontrol"
    scontrol.write_text(SCONTROL)
    scontrol.chmod(0o755)
    script = f". {ROOT}/slurm/launch.sh; launch run.sh {len(signals)} {code}"
    (place / "got").touch()
    path = f"{place}:{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "HPCINV_LAUNCHER": "bash", "SLURM_JOB_ID": "17"} | variables
    batch = subprocess.Popen(["bash", "-c", script], cwd=place, env=environment)
    try:
        for before, sent in enumerate(signals):
            _wait_for(place, before)
            batch.send_signal(sent)
        ended = batch.wait(20)
    finally:
        batch.kill()
    assert (place / "got").read_text().split() == [sent.name.removeprefix("SIG") for sent in signals]
    return ended, (place / "asked").read_text().strip() if (place / "asked").exists() else ""


def _wait_for(place: Path, signals: int) -> None:
    """Wait until the run is there and has got so many signals."""
    deadline = time.monotonic() + 20
    while not ((place / "ready").exists() and (place / "got").read_text().count("\n") == signals):
        assert time.monotonic() < deadline
        time.sleep(0.01)


USR1, TERM = signal.SIGUSR1, signal.SIGTERM


@pytest.mark.parametrize("signals", [(USR1,), (USR1, USR1, USR1)])
def test_a_run_that_usr1_has_stopped_and_that_is_saved_is_requeued(
    signals: tuple[signal.Signals, ...], tmp_path: Path
) -> None:
    assert launched(tmp_path, 75, *signals) == (75, "requeue 17")


def test_preempted_job_whose_ranks_alone_got_a_signal_is_requeued(tmp_path: Path) -> None:
    assert launched(tmp_path, 75, PREEMPTED="2026-11-22T00:00:41") == (75, "requeue 17")


def test_a_task_of_an_array_is_requeued_alone(tmp_path: Path) -> None:
    assert launched(tmp_path, 75, USR1, **TASK) == (75, "requeue 17_4")


@pytest.mark.parametrize(
    ("code", "signals"), [(75, (TERM,)), (75, (USR1, TERM)), (75, (TERM, USR1)), (75, ()), (0, (USR1,)), (3, (USR1,))]
)
def test_jobs_that_ended_otherwise_are_not_requeued(
    code: int, signals: tuple[signal.Signals, ...], tmp_path: Path
) -> None:
    """Cancelled, stopped by something else, finished or failed."""
    assert launched(tmp_path, code, *signals) == (code, "")


def test_a_signal_in_the_moment_of_the_launch_is_passed_on(tmp_path: Path) -> None:
    """When the run is there, but the script does not know its number yet."""
    (tmp_path / "run.sh").write_text(RUN)
    (tmp_path / "got").touch()
    (tmp_path / "scontrol").write_text(SCONTROL)
    (tmp_path / "scontrol").chmod(0o755)
    between = "case $BASH_COMMAND in launched=*) until [ -e ready ]; do sleep 0.01; done; kill -USR1 $$;; esac"
    script = f". {ROOT}/slurm/launch.sh; set -o functrace; trap '{between}' DEBUG; launch run.sh 1 75"
    path = f"{tmp_path}:{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "HPCINV_LAUNCHER": "bash", "SLURM_JOB_ID": "17"}
    ended = subprocess.run(["bash", "-c", script], cwd=tmp_path, env=environment, timeout=20)
    assert (ended.returncode, (tmp_path / "got").read_text()) == (75, "USR1\n")
    assert (tmp_path / "asked").read_text().strip() == "requeue 17"


def test_a_run_that_saves_nothing_is_requeued_at_most_twice_in_a_row(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    def stopped(number: int, **variables: str) -> str:
        place = tmp_path / "place"
        for name in ("got", "ready", "asked"):
            (place / name).unlink(missing_ok=True)
        place.mkdir(exist_ok=True)
        code, requeued = launched(place, 75, USR1, SLURM_RESTART_COUNT=str(number), **variables)
        assert code == 75
        return requeued

    again = "requeue 17"
    assert [stopped(0), stopped(1), stopped(2, SAVES="yes"), stopped(3), stopped(4), stopped(5)] == [again] * 5 + [""]
    message = capfd.readouterr()
    assert message.out.count("was stopped before it could save anything, and is requeued to try again") == 4
    assert message.out.count("has saved its state, and is requeued to go on") == 1
    assert message.err.count("job 17: not requeued any more: three times in a row it was stopped before") == 1
    assert not list((tmp_path / "place").glob(".hpcinv-*"))


@pytest.mark.parametrize(("limit", "is_told"), [("00:02:00", True), ("00:02:01", False), ("1-00:00:00", False)])
def test_a_time_limit_within_the_lead_is_reported_before_the_run(limit: str, is_told: bool, tmp_path: Path) -> None:
    """By the last option of the script, as Slurm takes it."""
    scontrol = tmp_path / "scontrol"
    scontrol.write_text(SCONTROL)
    scontrol.chmod(0o755)
    batch = tmp_path / "job.sbatch"
    options = "#SBATCH --signal=B:USR1@9\n#SBATCH --signal=B:USR1@120\n"
    batch.write_text(f"#!/bin/bash\n{options}. {ROOT}/slurm/launch.sh\nlaunch echo begins\n")
    path = f"{tmp_path}:{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "HPCINV_LAUNCHER": "env", "SLURM_JOB_ID": "17", "LIMIT": limit}
    done = subprocess.run(["bash", batch], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=20)
    assert (done.returncode, done.stdout) == (0, "begins\n")
    text = "job 17: warning: its time limit of 120 s is not above the 120 s that are kept for saving"
    assert done.stderr.startswith(text) if is_told else not done.stderr


def test_job_without_progress_is_not_requeued_for_ever(tmp_path: Path) -> None:
    assert launched(tmp_path, 75, USR1, SLURM_RESTART_COUNT="50") == (75, "")


@pytest.mark.parametrize(("launcher", "code"), [("no-such-launcher", 127), ("bash killed.sh", 137)])
def test_the_exit_code_of_a_launcher_that_fails_is_kept(launcher: str, code: int, tmp_path: Path) -> None:
    (tmp_path / "killed.sh").write_text("kill -KILL $$")
    environment = os.environ | {"HPCINV_LAUNCHER": launcher, "SLURM_JOB_ID": "17"}
    script = f". {ROOT}/slurm/launch.sh; launch command"
    assert subprocess.run(["bash", "-c", script], env=environment, cwd=tmp_path).returncode == code
