"""Cases that crash their process, or never end: the others go on, under the same command."""

from __future__ import annotations

import dataclasses
import re
import signal
import subprocess
import time
from pathlib import Path

import pytest
from helpers.command_line import BLOCK, ROOT, Started, hpcinv, hpcinv_here
from helpers.ledger_files import entries
from helpers.sweeps import records_of, write_sweep

from hpcinv.errors import JobError
from hpcinv.studies.batch.ledger.claims import DEADLY
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger
from hpcinv.studies.sweep.sweep_plan import load_sweep

GENERATOR = f"""
import ctypes, os, runpy, time

def build(gmsh, *, how: str = "", once: str = ""):
    if once and not os.path.exists(once):
        open(once, "w").close()
        ctypes.string_at(0)
    match how:
        case "SIGSEGV":
            ctypes.string_at(0)
        case "abort":
            os.abort()
        case "exit 0":
            os._exit(0)
        case "MPI_Abort":
            from mpi4py import MPI
            MPI.COMM_WORLD.Abort(3)
        case "killed":
            os.kill(os.getpid(), 9)
        case "loop":
            time.sleep(1000)
        case "stuck":
            ctypes.PyDLL(None).sleep(1000)  # it keeps Python's interpreter lock
    runpy.run_path({str(ROOT / "meshes" / "box.py")!r})["build"](gmsh, nx=2, ny=2, nz=2)
"""
STEPS = {"strategy": "fixed", "steps": 4000}


def crashing(directory: Path, how: list[str], good: int = 4, **more: object) -> Path:
    """A sweep with a case for each way to end in ``how``, and as many that are good."""
    (directory / "crash.py").write_text(GENERATOR)
    job = {**BLOCK, "mesh": {"file": "crash.py"}}
    axes = [
        {
            "name": "kind",
            "branches": {
                "good": {"axes": [{"grid": {"material.mu": [8000 + 500 * i for i in range(good)]}}]},
                "bad": {"axes": [{"grid": {"mesh.parameters.how": how}}]},
            },
        }
    ]
    return write_sweep(directory, axes, job=job, **more)


def statuses(sweep: Path) -> list[str]:
    return [record.status if record is not None else "open" for record in records_of(sweep).values()]


def test_cases_that_crash_take_too_long_or_are_killed_are_reported_and_the_other_is_solved(tmp_path: Path) -> None:
    """One that can stop itself at the next step, and one that cannot; kills may be due to a lack of memory."""
    sweep = crashing(tmp_path, ["exit 0", "stuck", "killed"], good=1, limit="2 s")
    content = sweep.read_text().replace("- 8000", "- 8000\n          solver: [{strategy: fixed, steps: 4000}, {}]")
    sweep.write_text(content)
    die_with(sweep, 4, DEADLY - 2, supervised=False)
    ended = hpcinv(2, "sweep", "run", sweep, cwd=tmp_path)
    assert ended.returncode == 3, ended.stdout + ended.stderr
    steps, good, crashed, stuck, killed = statuses(sweep)
    assert good == "converged"
    assert steps == stuck == "took longer than its limit of 2.0 s", ended.stdout
    assert crashed.startswith("its process crashed 2 times: ended with exit code 0")
    assert ended.stdout.count("crashed its process (ended by SIGKILL)") >= 2
    # On a busy machine the other rank may take the case between its fifth death and the record of that.
    assert re.fullmatch("the process that ran it was killed [56] times", killed)
    assert ended.stdout.count("and did not stop: its process was killed") == 1
    assert "2 × took longer than its limit of 2.0 s" in ended.stdout
    assert "converged: 1" in ended.stdout
    assert "failed: 4;" in ended.stdout
    again = hpcinv_here("sweep", "run", sweep, cwd=tmp_path)
    assert again.returncode == 3
    assert not re.findall(r"(?<!first: )case \d", again.stdout)
    retried = hpcinv_here("sweep", "retry", "--failed", sweep, cwd=tmp_path)
    assert "4 failed cases are open again" in retried.stdout


@pytest.mark.release
@pytest.mark.parametrize(("ranks", "per_case"), [(2, 1), (2, 2)])
def test_cases_that_crash_are_reported_and_all_others_are_solved(ranks: int, per_case: int, tmp_path: Path) -> None:
    how = ["exit 0"] if per_case == 1 else ["SIGSEGV", "abort", "exit 0", "MPI_Abort"]
    sweep = crashing(tmp_path, how, good=2)
    ended = hpcinv(ranks, "sweep", "run", sweep, "--ranks-per-case", per_case, cwd=tmp_path)
    assert ended.returncode == 3, ended.stdout + ended.stderr
    status_by_case = statuses(sweep)
    assert status_by_case[:2] == ["converged"] * 2
    expected = {
        "SIGSEGV": "ended by SIGSEGV",
        "abort": "ended by SIGABRT",
        "exit 0": "ended with exit code 0",
        "MPI_Abort": "ended with exit code 3",
    }
    for name, status in zip(how, status_by_case[2:], strict=True):
        assert status.startswith(f"its process crashed 2 times: {expected[name]}"), status
    assert "converged: 2" in ended.stdout
    assert f"failed: {len(how)};" in ended.stdout
    again = hpcinv_here("sweep", "run", sweep, cwd=tmp_path)
    assert again.returncode == 3
    assert not re.findall(r"(?<!first: )case \d", again.stdout)


@pytest.mark.release
def test_a_case_that_crashes_once_is_solved(tmp_path: Path) -> None:
    (tmp_path / "crash.py").write_text(GENERATOR)
    mesh = {"file": "crash.py", "parameters": {"once": str(tmp_path / "crashed")}}
    sweep = write_sweep(tmp_path, [{"grid": {"material.mu": [8000]}}], job={**BLOCK, "mesh": mesh})
    ended = hpcinv(1, "sweep", "run", sweep, cwd=tmp_path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "case 0, mu 8000: crashed its process (ended by SIGSEGV)" in ended.stdout
    (record,) = records_of(sweep).values()
    assert record is not None
    assert record.attempts == 2


@pytest.mark.release
def test_a_case_whose_process_is_killed_is_tried_more_often(tmp_path: Path) -> None:
    """The system may have been out of memory because of a neighbour."""
    sweep = crashing(tmp_path, ["killed"], good=1)
    die_with(sweep, 1, DEADLY - 2, supervised=False)
    ended = hpcinv(1, "sweep", "run", sweep, cwd=tmp_path)
    assert ended.returncode == 3, ended.stdout + ended.stderr
    assert ended.stdout.count("crashed its process (ended by SIGKILL)") >= 2
    good, killed = statuses(sweep)
    assert good == "converged"
    # On a busy machine the other rank may take the case between its fifth death and the record of that.
    assert re.fullmatch("the process that ran it was killed [56] times", killed)


def die_with(sweep: Path, number: int, times: int, *, supervised: bool) -> None:
    """Let so many processes have ended that had claimed a case."""
    plan = load_sweep(sweep)
    for _ in range(times):
        dead = subprocess.Popen(["true"])
        with Holder(plan.store) as holder:
            holder.identity = dataclasses.replace(holder.identity, pid=dead.pid, token=f"dead-{dead.pid}")
            dead.wait()
            assert Ledger(plan.store, holder, supervised=supervised).claim(plan.cases[number].key) is not None


@pytest.mark.everyday("False-False")
@pytest.mark.parametrize(("supervised", "solved"), [(True, True), (False, False)])
def test_kills_of_whole_allocations_are_not_the_fault_of_the_case(
    supervised: bool, solved: bool, tmp_path: Path
) -> None:
    """A supervisor would have reported only that the process died."""
    sweep = write_sweep(tmp_path, [{"grid": {"material.mu": [8000]}}])
    die_with(sweep, 0, DEADLY + 2, supervised=supervised)
    ended = hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
    assert ended.returncode == (0 if solved else 3), ended.stdout + ended.stderr
    assert statuses(sweep) == ["converged" if solved else "the process that ran it was killed 7 times"]


@pytest.mark.release
def test_cases_that_take_too_long_are_reported_and_all_others_are_solved(tmp_path: Path) -> None:
    """One that can stop itself at the next step, and one that cannot."""
    sweep = crashing(tmp_path, ["stuck"], good=1, limit="2 s")
    content = sweep.read_text().replace("- 8000", "- 8000\n          solver: [{strategy: fixed, steps: 4000}, {}]")
    sweep.write_text(content)
    begun = time.monotonic()
    ended = hpcinv(2, "sweep", "run", sweep, cwd=tmp_path)
    assert ended.returncode == 3, ended.stdout + ended.stderr
    status_by_case = statuses(sweep)
    assert status_by_case.count("took longer than its limit of 2.0 s") == 2, ended.stdout
    assert status_by_case.count("converged") == 1
    assert ended.stdout.count("and did not stop: its process was killed") == 1
    assert "2 × took longer than its limit of 2.0 s" in ended.stdout
    assert time.monotonic() - begun < 100
    retried = hpcinv_here("sweep", "retry", "--failed", sweep, cwd=tmp_path)
    assert "2 failed cases are open again" in retried.stdout


@pytest.mark.parametrize("limit", ["0 s", "-1 min", "10 mm", "soon"])
def test_a_limit_is_a_time(limit: str, tmp_path: Path) -> None:
    sweep = write_sweep(tmp_path, [{"grid": {"material.mu": [8000]}}], limit=limit)
    with pytest.raises(JobError, match=r"limit: (must be|'soon' is not a number)"):
        load_sweep(sweep)


def test_a_signal_while_a_case_is_stuck_gives_it_back(tmp_path: Path) -> None:
    sweep = crashing(tmp_path, ["loop"], good=1)
    with Started(2, "sweep", "run", sweep, cwd=tmp_path) as started:
        started.wait_for("case 0")
        started.send(signal.SIGTERM, [started.mpirun.pid])
        assert started.exit_code() == 75, started.text
        assert "1 cases left" in started.text
    assert any(entry.get("released") for entry in entries(tmp_path / "store"))


@pytest.mark.release
def test_without_restarts_the_launchers_ranks_solve_the_cases(tmp_path: Path) -> None:
    sweep = crashing(tmp_path, ["abort"], good=2)
    ended = hpcinv(2, "sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
    assert ended.returncode not in (0, 3)
    solved = statuses(sweep)
    assert solved[2] == "open"
