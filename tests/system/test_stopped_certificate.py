"""Signals to runs between mesh and first iteration, and within the certificate: nothing solved is lost."""

from __future__ import annotations

import json
import os
import pkgutil
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import BLOCK, hpcinv, hpcinv_here, write_job
from helpers.sweeps import records_of, write_sweep

from hpcinv.solver.equilibrium_path import EquilibriumPath
from hpcinv.trust.certificate import checks

# One rank sends itself a signal when a function of hpcinv is called.
SENDING = """
import importlib, os, runpy, signal, sys

where = {where!r}

def send():
    from mpi4py import MPI
    if MPI.COMM_WORLD.rank == 1:
        os.kill(os.getpid(), signal.SIGTERM)

class Finder:
    def find_spec(self, name, path, target=None):
        if name != where.rpartition(".")[0]:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        execute = spec.loader.exec_module

        def exec_module(module):
            execute(module)
            function = getattr(module, where.rpartition(".")[2])

            def sending(*args, **options):
                send()
                return function(*args, **options)

            setattr(module, function.__name__, sending)

        spec.loader.exec_module = exec_module
        return spec

import importlib.util
sys.meta_path.insert(0, Finder())
runpy.run_module("hpcinv", run_name="__main__", alter_sys=True)
"""
# A check sends a signal to its own process, and goes on for minutes.
BUSY = """
import os, runpy, signal, sys, time
import hpcinv.base.parallel.runtime
import hpcinv.trust.certificate.overlap
import hpcinv.base.parallel.signals

def busy(*_):
    os.kill(os.getpid(), signal.SIGTERM)
    begun = time.monotonic()
    while time.monotonic() - begun < 300:
        time.sleep(100)

hpcinv.base.parallel.signals.PATIENCE = 1.0
hpcinv.trust.certificate.overlap.OverlapCheck.lines = busy
runpy.run_module("hpcinv", run_name="__main__", alter_sys=True)
"""
CERTIFIED: dict[str, Any] = {"certificate": {}, "checkpoint": {"every": 100}}


def sending(directory: Path, where: str) -> Path:
    """A script that runs hpcinv and sends SIGTERM to the second rank at a call of a function."""
    script = directory / "sends.py"
    script.write_text(SENDING.format(where=where))
    return script


def send_at(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Send SIGTERM to this process at calls of a function, which a command in this process makes."""
    holder, name = pkgutil.resolve_name(where.rpartition(".")[0]), where.rpartition(".")[2]
    function = getattr(holder, name)

    def send(*arguments: Any, **options: Any) -> Any:
        os.kill(os.getpid(), signal.SIGTERM)
        return function(*arguments, **options)

    monkeypatch.setattr(holder, name, send)


def summary(run: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((run / "summary.json").read_text())
    return content


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Summary of a run that nothing interrupts."""
    place = tmp_path_factory.mktemp("whole")
    done = hpcinv_here("run", write_job(place / "job.yaml", BLOCK, **CERTIFIED), "--output", "run", cwd=place)
    assert done.returncode == 0, done.stderr
    return summary(place / "run")


CHECKS = [f"{check.__module__}.{check.__name__}.lines" for check in checks() if "applies" not in vars(check)]
"""what all bodies have"""


@pytest.mark.everyday("hpcinv.trust.certificate.round_trip.RoundTripCheck.lines-1")
@pytest.mark.parametrize(
    ("where", "ranks"),
    [*((where, 1) for where in CHECKS), ("hpcinv.trust.discretisation.discretisation_error.estimate", 2)],
)
def test_a_signal_in_the_certificate_stops_there_and_a_resume_solves_nothing_again(
    where: str, ranks: int, whole: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The signal comes while the check before, or this one, is made."""
    job = write_job(tmp_path / "job.yaml", BLOCK, **CERTIFIED)
    if ranks == 1:
        with monkeypatch.context() as patch:
            send_at(where, patch)
            stopped = hpcinv_here("run", job, "--output", "run", cwd=tmp_path)
    else:
        script = sending(tmp_path, where)
        stopped = hpcinv(ranks, "run", job, "--output", "run", cwd=tmp_path, script=script)
    run = tmp_path / "run"
    if where == CHECKS[-1]:  # a complete certificate is kept
        assert stopped.returncode == 0, stopped.stderr
        return
    assert stopped.returncode == 75, stopped.stderr
    assert stopped.stderr.count("stopped by a signal in the certificate; the solution is saved") == 1
    assert "Traceback" not in stopped.stderr
    assert summary(run)["status"] == "stopped by a signal"
    assert not list(run.glob("**/.*partial*"))
    assert [p.name for p in sorted((run / "checkpoints").iterdir())] == ["0001"]
    done = hpcinv_here("resume", "run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("  load ") == 0
    content = summary(run)
    assert content["status"] == "converged"
    assert content["solutions"][0]["factorizations"] == whole["solutions"][0]["factorizations"]
    assert content["quantities"]["top"] == pytest.approx(whole["quantities"]["top"], rel=1e-9)
    lines = [[(line["name"], line["verdict"]) for line in s["certificate"]["lines"]] for s in (content, whole)]
    assert lines[0] == lines[1]
    assert len([*(run / "checkpoints").iterdir()]) == 1


@pytest.mark.release
def test_a_signal_in_the_certificate_keeps_both_directions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = write_job(tmp_path / "job.yaml", BLOCK, analysis="round_trip", **CERTIFIED)
    with monkeypatch.context() as patch:
        send_at("hpcinv.trust.certificate.overlap.OverlapCheck.lines", patch)
        stopped = hpcinv_here("run", job, "--output", "run", cwd=tmp_path)
    assert stopped.returncode == 75, stopped.stderr
    done = hpcinv_here("resume", "run", "--certificate", "quick", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("  load ") == 0
    content = summary(tmp_path / "run")
    assert [solution["direction"] for solution in content["solutions"]] == ["inverse", "forward"]
    assert content["job"]["certificate"]["level"] == "quick"


def test_a_check_that_goes_on_after_a_signal_is_ended(tmp_path: Path) -> None:
    """Such as a long factorization: the run ends after some seconds, and goes on as after any other stop."""
    script = tmp_path / "busy.py"
    script.write_text(BUSY)
    job = write_job(tmp_path / "job.yaml", BLOCK, certificate={}, checkpoint={})
    begun = time.monotonic()
    stopped = hpcinv(1, "run", job, "--output", "run", cwd=tmp_path, script=script)
    assert time.monotonic() - begun < 60
    assert stopped.returncode == 75, stopped.stderr
    assert stopped.stderr.count("stopped by a signal in the certificate; the solution is saved") == 1
    assert summary(tmp_path / "run")["status"] == "stopped by a signal"
    done = hpcinv_here("resume", "run", "--certificate", "quick", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("  load ") == 0


@pytest.mark.release
def test_a_case_of_a_sweep_that_was_stopped_in_its_certificate_is_not_solved_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sweep = write_sweep(tmp_path, [{"grid": {"material.mu": [8000]}}], job={**BLOCK, **CERTIFIED})
    with monkeypatch.context() as patch:
        send_at("hpcinv.trust.certificate.overlap.OverlapCheck.lines", patch)
        stopped = hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
    assert stopped.returncode == 75, stopped.stdout + stopped.stderr
    assert [*records_of(sweep).values()] == [None]
    (run,) = [path.parent for path in tmp_path.glob("**/checkpoints")]
    assert summary(run)["status"] == "stopped by a signal"

    def reach_nothing(path: EquilibriumPath, *_: Any) -> list[Any]:
        assert path.load == 1.0  # a solve of the job, rather than of its certificate
        return []

    monkeypatch.setattr("hpcinv.solver.methods.direct_method.reach", reach_nothing)
    done = hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    (record,) = records_of(sweep).values()
    assert record is not None
    assert record.converged


@pytest.mark.parametrize("where", ["hpcinv.preparation.check_points", "hpcinv.mesh.body.build_regions"])
def test_a_signal_before_there_is_a_directory_leaves_none(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = write_job(tmp_path / "job.yaml", BLOCK)
    send_at(where, monkeypatch)
    stopped = hpcinv_here("run", job, "--output", "run", cwd=tmp_path)
    assert stopped.returncode == 75, stopped.stderr
    assert stopped.stderr.count("stopped by a signal before there was anything to save") == 1
    assert "Traceback" not in stopped.stderr
    assert not (tmp_path / "run").exists()


@pytest.mark.release
def test_a_signal_before_the_solve_leaves_a_run_that_begins_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = write_job(tmp_path / "job.yaml", BLOCK)
    with monkeypatch.context() as patch:
        send_at("hpcinv.driver.totals_of", patch)
        stopped = hpcinv_here("run", job, "--output", "run", cwd=tmp_path)
    assert stopped.returncode == 75, stopped.stderr
    assert stopped.stderr.count("at load factor 0; there was no state to save yet") == 1
    content = summary(tmp_path / "run")
    assert content["status"] == "stopped by a signal"
    done = hpcinv_here("resume", "run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert summary(tmp_path / "run")["status"] == "converged"
