"""Signals before a run has begun to solve, and code of a job that ends the process: exit codes and messages."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.command_line import CUBE, PATIENCE, ROOT, Started, environment, hpcinv, write_job

MESHING = """
def build(gmsh):
    print("meshing", flush=True)
    {body}
"""
BODIES = {
    "gmsh": """gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.004)
    gmsh.model.mesh.generate(3)""",  # minutes, and gigabytes
    "Python": """while True:
        pass""",
}


def meshing(directory: Path, body: str) -> Path:
    (directory / "long.py").write_text(MESHING.format(body=BODIES[body]))
    return write_job(directory / "long.yaml", CUBE, mesh={"file": "long.py", "maximum_cells": 10**9})


@pytest.mark.parametrize(
    ("body", "name", "ranks", "code"),
    [
        ("gmsh", "SIGTERM", 2, 75),
        ("gmsh", "SIGINT", 2, 130),
        ("gmsh", "SIGUSR1", 1, 75),
        ("Python", "SIGTERM", 1, 75),
    ],
)
def test_a_signal_while_a_mesh_is_made_ends_the_run(
    body: str, name: str, ranks: int, code: int, tmp_path: Path
) -> None:
    job = meshing(tmp_path, body)
    with Started(ranks, "run", job, "--output", "run", cwd=tmp_path) as started:
        started.wait_for("meshing")
        time.sleep(1.0)
        begun = time.monotonic()
        started.send(signal.Signals[name], [started.mpirun.pid])
        assert started.exit_code() == code, started.text
        assert time.monotonic() - begun < 20
    assert "Traceback" not in started.text
    assert started.text.count("stopped by a signal before there was anything to save") == (code == 75)
    assert not (tmp_path / "run").exists()


# The signal comes just before gmsh is at work: then two threads handle it.
BEFORE_GMSH = """
import os, runpy, signal
import hpcinv.mesh.io.gmsh_model as gmsh_model
import hpcinv.parallel.signals

load = gmsh_model._load

def load_and_send():
    gmsh = load()
    os.kill(os.getpid(), signal.SIGTERM)
    return gmsh

hpcinv.parallel.signals._GRACE = 0.1
gmsh_model._load = load_and_send
runpy.run_module("hpcinv", run_name="__main__", alter_sys=True)
"""


def test_a_signal_just_before_a_mesh_is_made_is_told_once(tmp_path: Path) -> None:
    job = meshing(tmp_path, "Python")
    (tmp_path / "sends.py").write_text(BEFORE_GMSH)
    ended = hpcinv(2, "run", job, "--output", "run", cwd=tmp_path, script=tmp_path / "sends.py")
    assert ended.returncode == 75, ended.stderr
    assert ended.stderr.count("stopped by a signal before there was anything to save") == 1


# It tells when the first of our own modules is loaded; what Python does before that is out of reach.
MARKING = """
import pathlib, runpy, sys
import hpcinv.parallel.signals

note = hpcinv.parallel.signals.note_while_starting

def note_and_mark():
    note()
    pathlib.Path(sys.argv.pop(1)).touch()

hpcinv.parallel.signals.note_while_starting = note_and_mark
runpy.run_module("hpcinv", run_name="__main__", alter_sys=True)
"""


@pytest.mark.parametrize("ranks", [0, 2])
@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 75), ("SIGINT", 130)])
def test_a_signal_at_any_moment_of_the_start_ends_with_its_code(
    name: str, code: int, ranks: int, tmp_path: Path
) -> None:
    job = meshing(tmp_path, "Python")
    (tmp_path / "marking.py").write_text(MARKING)
    launcher = [str(Path(sys.executable).parent / "mpirun"), "-n", str(ranks)] if ranks else []
    for delay in (0.0, 0.3, 0.8, 1.6):
        mark = tmp_path / f"mark-{delay}"
        program = [sys.executable, "marking.py", str(mark), "run", str(job), "--output", "run"]
        started = subprocess.Popen(
            [*launcher, *program], cwd=tmp_path, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )
        deadline = time.monotonic() + PATIENCE
        while not mark.exists():
            assert time.monotonic() < deadline
            time.sleep(0.005)
        time.sleep(delay + 0.2 * bool(ranks))  # until the other rank has come as far
        started.send_signal(signal.Signals[name])
        output, _ = started.communicate(timeout=PATIENCE)
        assert started.returncode == code, f"{delay}: {output.decode()}"
        assert b"Traceback" not in output, f"{delay}: {output.decode()}"
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("where", "ranks"), [("generator", 1), ("generator", 2), ("plugin", 2), ("generator in a thread", 1)]
)
def test_exit_code_0_from_code_of_a_job_is_no_success(where: str, ranks: int, tmp_path: Path) -> None:
    (tmp_path / "ends.py").write_text(
        {
            "generator": "import os\n\ndef build(gmsh):\n    os._exit(0)\n",
            "generator in a thread": "import os, threading\n\ndef build(gmsh):\n"
            "    t = threading.Thread(target=os._exit, args=(0,))\n    t.start()\n    t.join()\n",
            "plugin": "import os\nos._exit(0)\n",
        }[where]
    )
    changes = {"plugins": ["ends.py"]} if where == "plugin" else {"mesh": {"file": "ends.py"}}
    job = write_job(tmp_path / "job.yaml", CUBE, **changes)
    ended = hpcinv(ranks, "run", job, "--output", "run", cwd=tmp_path)
    assert ended.returncode not in (0, 75), ended.stdout + ended.stderr
    assert "os._exit(0) has ended the process before the command was done" in ended.stderr
    if where != "generator in a thread":
        assert "ends.py, line" in ended.stderr
    assert not (tmp_path / "run").exists()


def test_processes_that_code_of_a_job_forks_end_as_they_like(tmp_path: Path) -> None:
    box = str(ROOT / "meshes" / "box.py")
    (tmp_path / "forks.py").write_text(
        "import os, runpy\n\ndef build(gmsh):\n    if not (child := os.fork()):\n        os._exit(0)\n"
        "    assert os.waitpid(child, 0)[1] == 0\n"
        f"    runpy.run_path({box!r})['build'](gmsh, nx=2, ny=2, nz=2)\n"
    )
    job = write_job(tmp_path / "job.yaml", CUBE, mesh={"file": "forks.py"})
    ended = hpcinv(1, "run", job, "--output", "run", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
