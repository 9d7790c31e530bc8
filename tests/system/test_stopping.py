"""Signals before a run has begun to solve, and code of a job that ends the process: exit codes and messages."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import BLOCK, CUBE, MPIRUN, PATIENCE, ROOT, Started, environment, hpcinv, write_job
from helpers.mesh_cases import spec
from helpers.sweeps import records_of, write_sweep

from hpcinv.mesh import read_source
from hpcinv.mesh.mesh_files import SAVERS

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


@pytest.mark.everyday("gmsh-SIGTERM-2-75")
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
import hpcinv.base.parallel.signals

load = gmsh_model._load

def load_and_send():
    gmsh = load()
    os.kill(os.getpid(), signal.SIGTERM)
    return gmsh

hpcinv.base.parallel.signals._GRACE = 0.1
gmsh_model._load = load_and_send
runpy.run_module("hpcinv", run_name="__main__", alter_sys=True)
"""


def test_a_signal_just_before_a_mesh_is_made_is_reported_once(tmp_path: Path) -> None:
    job = meshing(tmp_path, "Python")
    (tmp_path / "sends.py").write_text(BEFORE_GMSH)
    ended = hpcinv(2, "run", job, "--output", "run", cwd=tmp_path, script=tmp_path / "sends.py")
    assert ended.returncode == 75, ended.stderr
    assert ended.stderr.count("stopped by a signal before there was anything to save") == 1


# The process that reads the mesh takes time, as for a large one.
SLOW_READER = """
import pathlib, runpy, time
pathlib.Path({mark!r}).touch()
time.sleep(2.0)
runpy.run_path({reader!r}, run_name="__main__")
"""
STARTING_SLOW_READER = """
import subprocess, sys

start = subprocess.Popen.__init__

def start_slow_reader(self, command, *args, **options):
    start(self, [{slow!r} if word.endswith("isolated_reader.py") else word for word in command], *args, **options)

if "pytest" not in sys.modules:  # the test reads the job, too
    subprocess.Popen.__init__ = start_slow_reader
"""  # it imports nothing from the mesh: PETSc starts on all ranks at once


def with_slow_reader(directory: Path, suffix: str) -> tuple[dict[str, Any], Path]:
    """A job with a mesh in a file and a slow reader of it, and the file that the reader makes when it begins."""
    slow, mark = directory / "slow_reader.py", directory / "reading"
    reader = ROOT / "hpcinv" / "base" / "reading" / "isolated_reader.py"
    slow.write_text(SLOW_READER.format(mark=str(mark), reader=str(reader)))
    plugin = directory / "plugin.py"
    plugin.write_text(STARTING_SLOW_READER.format(slow=str(slow)))
    mesh = box(directory / f"box{suffix}")
    return {**BLOCK, "mesh": {"file": mesh.name}, "plugins": [plugin.name]}, mark


def box(path: Path) -> Path:
    generator = ROOT / "meshes" / "box.py"
    source = read_source(spec(generator, parameters={"nx": 2, "ny": 2, "nz": 2}), generator)
    SAVERS[path.suffix](path, source, source.points)
    return path


def wait_until_there(path: Path) -> None:
    deadline = time.monotonic() + 60
    while not path.exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def readers(directory: Path) -> list[str]:
    """Processes that run the slow reader."""
    name = str(directory / "slow_reader.py").encode()
    return [p.parent.name for p in Path("/proc").glob("[0-9]*/cmdline") if name in contents(p)]


def contents(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:  # the process has ended
        return b""


@pytest.mark.everyday("SIGTERM-75-.msh", "SIGINT-130-.vtu")
@pytest.mark.parametrize("suffix", [".msh", ".vtu"])
@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 75), ("SIGUSR1", 75), ("SIGINT", 130), ("SIGKILL", None)])
def test_a_signal_while_a_process_reads_a_mesh_does_not_damage_it(
    suffix: str, name: str, code: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It goes to mpirun, which forwards it to all processes; SIGKILL goes to the ranks only."""
    monkeypatch.setenv("HPCINV_KERNELS", str(tmp_path / "kernels"))  # where no file is known as read already
    content, mark = with_slow_reader(tmp_path, suffix)
    job = write_job(tmp_path / "job.yaml", content)
    with Started(2, "run", job, "--output", "run", cwd=tmp_path) as started:
        wait_until_there(mark)
        to = [p for p in started.ranks() if str(p) not in readers(tmp_path)] if code is None else [started.mpirun.pid]
        started.send(signal.Signals[name], to)
        ended = started.exit_code()
        assert ended == code or (code is None and ended), started.text
    assert "cannot read it" not in started.text
    assert "Traceback" not in started.text
    time.sleep(0.2)
    assert not readers(tmp_path)


@pytest.mark.everyday("separate")
@pytest.mark.parametrize(
    ("ranks", "options"), [(1, ["--no-isolation"]), (2, ["--ranks-per-case", "2"])], ids=["launcher", "separate"]
)
def test_a_signal_while_a_process_reads_the_mesh_of_a_case_leaves_the_case_open(
    ranks: int, options: list[str], tmp_path: Path
) -> None:
    job, mark = with_slow_reader(tmp_path, ".vtu")
    sweep = write_sweep(tmp_path, [{"grid": {"material.mu": [8000]}}], job=job)
    with Started(ranks, "sweep", "run", sweep, *options, cwd=tmp_path) as started:
        wait_until_there(mark)
        started.send(signal.SIGUSR1, [started.mpirun.pid])
        assert started.exit_code() == 75, started.text
    assert [*records_of(sweep).values()] == [None]


# It marks when the first of our own modules is loaded; what Python does before that is out of reach.
MARKING = """
import pathlib, runpy, sys
import hpcinv.base.parallel.signals

note = hpcinv.base.parallel.signals.note_while_starting

def note_and_mark():
    note()
    pathlib.Path(sys.argv.pop(1)).touch()

hpcinv.base.parallel.signals.note_while_starting = note_and_mark
runpy.run_module("hpcinv", run_name="__main__", alter_sys=True)
"""


@pytest.mark.everyday("SIGTERM-75-2", "SIGINT-130-0")
@pytest.mark.parametrize("ranks", [0, 2])
@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 75), ("SIGINT", 130)])
def test_a_signal_at_any_moment_of_the_start_ends_with_its_code(
    name: str, code: int, ranks: int, tmp_path: Path
) -> None:
    job = meshing(tmp_path, "Python")
    (tmp_path / "marking.py").write_text(MARKING)
    launcher = [str(Path(sys.executable).parent / "mpirun"), "-n", str(ranks)] if ranks else []
    for delay in (0.0, 0.3, 0.8, 1.6)[bool(ranks) :: 2]:
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


@pytest.mark.everyday("plugin-1")
@pytest.mark.parametrize(("where", "ranks"), [("generator", 2), ("plugin", 1), ("generator in a thread", 1)])
def test_exit_code_0_from_code_of_a_job_does_not_count(where: str, ranks: int, tmp_path: Path) -> None:
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


@pytest.mark.everyday("exit-module", "replaced-script", "raised-module")
@pytest.mark.parametrize(
    "program", [[sys.executable, "-m", "hpcinv"], [str(MPIRUN.with_name("hpcinv"))]], ids=["module", "script"]
)
@pytest.mark.parametrize(
    ("plugin", "message"),
    [
        ("import os\nos._exit(0)\n", "ends.py, line 2: os._exit(0) has ended the process before the command was done"),
        (
            "import os\nos.execl('/bin/true', 'true')\n",
            "ends.py, line 2: os.execv has ended the process before the command was done",
        ),
        ("import sys\nsys.exit(0)\n", "cannot be imported: SystemExit: 0 (line 2)"),
    ],
    ids=["exit", "replaced", "raised"],
)
def test_a_plugin_that_ends_the_process_fails_validate(
    program: list[str], plugin: str, message: str, tmp_path: Path
) -> None:
    (tmp_path / "ends.py").write_text(plugin)
    job = write_job(tmp_path / "job.yaml", CUBE, plugins=["ends.py"])
    ended = subprocess.run([*program, "validate", job], env=environment(), capture_output=True, text=True)
    assert ended.returncode in (1, 2), ended.stdout
    assert message in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.release
def test_a_plugin_that_replaces_the_process_fails_the_run(tmp_path: Path) -> None:
    (tmp_path / "ends.py").write_text("import os\nos.execl('/bin/true', 'true')\n")
    ended = hpcinv(1, "run", write_job(tmp_path / "job.yaml", CUBE, plugins=["ends.py"]), cwd=tmp_path)
    assert ended.returncode == 1
    assert "os.execv has ended the process before the command was done" in ended.stderr


@pytest.mark.everyday("run-1")
@pytest.mark.parametrize(("command", "ranks"), [("run", 1), ("run", 2), ("validate", 1)])
def test_a_lack_of_memory_is_reported_without_a_traceback(command: str, ranks: int, tmp_path: Path) -> None:
    """Of NumPy, in code of a job."""
    text = "import numpy as np\n\ndef build(gmsh):\n    raise MemoryError\n"
    (tmp_path / "large.py").write_text(text if command == "run" else "raise MemoryError\n")
    changes = {"mesh": {"file": "large.py"}} if command == "run" else {"plugins": ["large.py"]}
    ended = hpcinv(ranks, command, write_job(tmp_path / "job.yaml", CUBE, **changes), cwd=tmp_path)
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.count("MemoryError: there is not enough memory") == 1
    assert "Traceback" not in ended.stderr


@pytest.mark.release
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
