"""The command line for tests: under the real mpirun, to the end or sent signals, or in the processes of the test."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, TextIO

import yaml

from helpers.silicone_beam import beam
from hpcinv.__main__ import main
from hpcinv.base.parallel.runtime import MPI

ROOT = Path(__file__).parents[2]
MPIRUN = Path(sys.executable).parent / "mpirun"
# A test of its own never takes this long; a run that hangs is ended by mpirun.
PATIENCE = 300

# Without what costs a solve.
NO_CERTIFICATE: dict[str, Any] = {"round_trip": "off", "stability": False, "estimate": False, "overlap": False}

BEAM: Mapping[str, Any] = {
    **beam(),
    "mesh": {"file": str(ROOT / "meshes" / "pdms_beam.py"), "parameters": {"size": "4 mm"}, "geometry_degree": 2},
    "certificate": NO_CERTIFICATE,
}
CUBE: Mapping[str, Any] = {
    "analysis": "forward",
    "mesh": {"file": str(ROOT / "meshes" / "box.py"), "parameters": {"nx": 2, "ny": 2, "nz": 2}},
    "material": {"law": "neo-hookean", "young": "1 MPa", "poisson": 0.3},
    "supports": [{"region": "boundary", "displacement": ["-0.1*y", 0, 0]}],
    "certificate": NO_CERTIFICATE,
}
BLOCK: Mapping[str, Any] = {
    "mesh": {"file": str(ROOT / "meshes" / "box.py"), "parameters": {"nx": 2, "ny": 2, "nz": 2}},
    "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
    "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 200}],
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
    "quantities": [{"name": "top", "of": "uz", "at": [0.5, 0.5, 1]}],
    "certificate": NO_CERTIFICATE,
}
"""A unit cube that stands on its clamped bottom; its height before it was loaded is asked for."""
COLUMN: dict[str, Any] = {
    "analysis": "inverse",
    "mesh": {"file": str(ROOT / "meshes" / "box.py"), "parameters": {"lx": 0.2, "ly": 0.2, "nx": 1, "ny": 1, "nz": 4}},
    "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
    "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000, "density_in": "current"}],
    "supports": [{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
    "quantities": [
        {"name": "length", "of": "Z", "on": "z1", "reduce": "mean"},
        {"name": "top", "of": "displacement", "at": [0.1, 0.1, 1.0]},
    ],
}
"""A column that only its length can change, under its weight."""


def write_job(path: Path, base: Mapping[str, Any], **changes: Any) -> Path:
    """A job file: ``base`` with some sections replaced."""
    path.write_text(yaml.safe_dump({**base, **changes}, sort_keys=False))
    return path


def command(ranks: int, *arguments: object, script: Path | None = None) -> list[str]:
    program = [str(script)] if script else ["-m", "hpcinv"]
    return [str(MPIRUN), "-n", str(ranks), sys.executable, *program, *map(str, arguments)]


def environment(**changes: str) -> dict[str, str]:
    """What a user has: nothing set for MPI, and the project importable from anywhere."""
    inherited = {k: v for k, v in os.environ.items() if k not in ("OMP_NUM_THREADS", "UCX_TLS")}
    return inherited | {"PYTHONPATH": str(ROOT), "MPIEXEC_TIMEOUT": str(PATIENCE)} | changes


def hpcinv(
    ranks: int, *arguments: object, cwd: Path, script: Path | None = None, **env: str
) -> subprocess.CompletedProcess[str]:
    """Run to the end."""
    return subprocess.run(
        command(ranks, *arguments, script=script),
        cwd=cwd,
        env=environment(**env),
        capture_output=True,
        text=True,
        timeout=PATIENCE + 10,
        check=False,
    )


def hpcinv_here(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run to the end on the ranks of this test, which saves 1.5 s of processor time a rank.

    Returns:
        on each rank: the output of all ranks, and the largest of their exit codes
    """
    comm, typed, before = MPI.COMM_WORLD, [str(argument) for argument in arguments], Path.cwd()
    comm.barrier()  # each rank may have written the same job
    gc.collect()  # a run that begins while what another has left is there keeps 22 of 2,048 communicators for ever
    with _caught(1, contextlib.redirect_stdout) as out, _caught(2, contextlib.redirect_stderr) as err:
        try:
            os.chdir(cwd)
            code = main(typed)
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 1
        finally:
            os.chdir(before)
    printed = ["".join(comm.allgather(lines[0])) for lines in (out, err)]
    return subprocess.CompletedProcess(typed, comm.allreduce(code, MPI.MAX), *printed)


@contextlib.contextmanager
def _caught(descriptor: int, redirect: Callable[[TextIO], AbstractContextManager[object]]) -> Iterator[list[str]]:
    """Catch what Python and libraries print; the list has it in the end."""
    printed: list[str] = []
    flush, before = ctypes.CDLL(None).fflush, os.dup(descriptor)
    flush(None)
    with tempfile.TemporaryFile("w+", buffering=1) as file:
        try:
            os.dup2(file.fileno(), descriptor)
            with redirect(file):
                yield printed
        finally:
            flush(None)
            os.dup2(before, descriptor)
            os.close(before)
            file.seek(0)
            printed.append(file.read())


class Started:
    """A run that goes on while the test does something to it; use it as a context, which leaves nothing running."""

    def __init__(self, ranks: int, *arguments: object, cwd: Path) -> None:
        self.log = cwd / f"log-{time.monotonic_ns()}"
        with self.log.open("w") as log:
            self.mpirun = subprocess.Popen(
                command(ranks, *arguments), cwd=cwd, env=environment(), stdout=log, stderr=subprocess.STDOUT
            )

    def __enter__(self) -> Started:
        return self

    def __exit__(self, *_: object) -> None:
        if self.mpirun.poll() is None:
            self.kill()

    @property
    def text(self) -> str:
        return self.log.read_text()

    def wait_for(self, text: str) -> None:
        """Wait until it has printed this."""
        deadline = time.monotonic() + PATIENCE
        while text not in self.text:
            assert self.mpirun.poll() is None, f"ended before {text!r}:\n{self.text}"
            assert time.monotonic() < deadline, f"never printed {text!r}:\n{self.text}"
            time.sleep(0.01)

    def ranks(self) -> list[int]:
        """Process numbers of the ranks."""
        return [p for p in self._processes() if "python" in _program(p)]

    def send(self, number: signal.Signals, processes: Sequence[int]) -> None:
        for process in processes:
            with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
                os.kill(process, number)

    def kill(self) -> None:
        """End mpirun, its proxy and the ranks at once, as a node that fails does, and wait until they write no more."""
        others = self._processes()
        self.send(signal.SIGKILL, [self.mpirun.pid, *others])
        self.mpirun.wait()
        while any(map(_is_alive, others)):
            time.sleep(0.01)

    def exit_code(self) -> int:
        return self.mpirun.wait(PATIENCE)

    def _processes(self) -> list[int]:
        """All that descend from mpirun."""
        processes: list[int] = []
        for parent in iter_growing(self.mpirun.pid, processes):
            processes += _children(parent)
        return processes


def iter_growing(first: int, more: list[int]) -> Iterator[int]:
    """``first``, then a list that grows meanwhile."""
    yield first
    yield from more


def _children(parent: int) -> list[int]:
    children = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            if int(path.read_text().rpartition(")")[2].split()[1]) == parent:
                children.append(int(path.parent.name))
        except OSError:  # it has ended meanwhile
            continue
    return children


def _is_alive(process: int) -> bool:
    try:
        has_ended = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
        return not has_ended or len(list(Path(f"/proc/{process}/task").iterdir())) > 1  # threads keep its files open
    except OSError:  # it has ended
        return False


def _program(process: int) -> str:
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0")[0].decode()
    except OSError:  # it has ended
        return ""
