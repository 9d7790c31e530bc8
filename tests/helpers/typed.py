"""Commands of pages, typed in a shell where `hpcinv`, `python` and `mpirun` are those of the tests."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from helpers.command_line import MPIRUN, environment

PROGRAMS = os.pathsep.join([str(Path(sys.executable).parent), str(MPIRUN.parent)])


def type_in(line: str, directory: Path) -> None:
    """Type a line, which must succeed."""
    settings = environment() | {"OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")}
    settings["PATH"] = os.pathsep.join([PROGRAMS, os.environ["PATH"]])
    found = subprocess.run(line, shell=True, cwd=directory, env=settings, capture_output=True, text=True, timeout=900)
    assert found.returncode == 0, f"{line}\n{found.stdout[-2000:]}\n{found.stderr[-2000:]}"
