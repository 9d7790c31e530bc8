"""Commands in forks of a server that has imported the stack: a start takes 0.1 s of processor time instead of 2.5 s.

The server imports everything without starting MPI, so that each fork starts MPI and PETSc itself, as a rank of mpirun
or alone. Forks do not show start-up: order and laziness of imports, variables that are read at imports (of Python, BLAS
and malloc), entry points of packages, messages on missing packages, signals during imports, and the process's own
memory and number (the manager's process is a stand-in). Tests about these use processes of their own.
"""

from __future__ import annotations

import atexit
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
LEFT_OUT = ("OMP_NUM_THREADS", "UCX_TLS")
"""variables that conftest.py and mpi-pytest set, and a user has not"""
READ_AT_IMPORTS = {
    "CC",
    "CFLAGS",
    "XDG_CACHE_HOME",
    "HOME",
    "OMP_NUM_THREADS",
    "GLIBC_TUNABLES",
    "LD_PRELOAD",
    "LD_LIBRARY_PATH",
}
STARTS_OF_READ = (
    "HPCINV_",
    "MALLOC_",
    "OPENBLAS_",
    "PYTHONH",
    "PYTHONN",
    "PYTHOND",
    "PYTHONO",
    "PYTHONU",
    "PYTHONI",
    "PYTHONW",
)


def python_for(environment: Mapping[str, str]) -> str:
    """Return the program that runs ``-m hpcinv`` in forks, and all else as Python; start its server if need be.

    It is Python itself if the environment differs from the server's in what imports read.
    """
    own = _environment()
    names = [name for name in {*own, *environment} if name in READ_AT_IMPORTS or name.startswith(STARTS_OF_READ)]
    if any(own.get(name) != environment.get(name) for name in names):
        return sys.executable
    return _Server.running().program


def _environment() -> dict[str, str]:
    return _Server.environment or {name: value for name, value in os.environ.items() if name not in LEFT_OUT}


class _Server:
    """A server, which ends with this process: its standard input is closed."""

    environment: ClassVar[dict[str, str]] = {}
    process: ClassVar[_Server | None] = None

    def __init__(self) -> None:
        directory = Path(tempfile.mkdtemp(prefix="hpcinv-forks-"))
        atexit.register(_remove, os.getpid(), directory)
        program = directory / "python"
        program.write_text(f"#!{sys.executable} -IS\n{(HERE / 'forked_python.py').read_text()}")
        program.chmod(0o755)
        self.program, self.log = str(program), directory / "log"
        command = [sys.executable, "-P", str(HERE / "fork_server.py"), str(directory)]
        self.environment.update(_environment())
        with self.log.open("wb") as log:
            self.server = subprocess.Popen(
                command,
                env=self.environment | {"PYTHONPATH": str(ROOT)},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                cwd=ROOT,
            )

    @classmethod
    def running(cls) -> _Server:
        """Return the server of this process, once it listens."""
        if cls.process is None:
            cls.process = cls()
            assert cls.process.server.stdout is not None
            if cls.process.server.stdout.readline() != b"ready\n":
                raise RuntimeError(f"the server of forks does not start:\n{cls.process.log.read_text()}")
        return cls.process


def _remove(process: int, directory: Path) -> None:
    if os.getpid() == process:
        shutil.rmtree(directory, ignore_errors=True)
