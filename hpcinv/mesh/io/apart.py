"""Reading in a process of its own what could end the one that reads it: VTK and gmsh do not survive damaged files."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

from hpcinv.errors import MeshError

_PROGRAM = Path(__file__).with_name("process.py")


def run_apart(action: str, path: Path, *arguments: str) -> subprocess.CompletedProcess[bytes]:
    """Let ``process.py`` act on a file; nothing that it prints is seen."""
    command = [sys.executable, "-P", str(_PROGRAM), action, str(path.absolute()), *arguments]
    return subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, check=False)


def rehearse_msh(path: Path, called: Path) -> None:
    """Raise ``MeshError``, which names ``called``, for an MSH file that ends the process in which gmsh reads it."""
    if (code := run_apart("msh", path).returncode) < 0:
        end = signal.Signals(-code).name
        raise MeshError(f"{called}: gmsh cannot read it: it ended ({end}) while it did", "Is the file whole?")
