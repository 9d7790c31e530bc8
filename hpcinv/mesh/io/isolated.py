"""Mesh files read in a separate process, because VTK and gmsh may crash on damaged files."""

import signal
import subprocess
import sys
from pathlib import Path

from hpcinv.errors import MeshError

_PROGRAM = Path(__file__).with_name("isolated_reader.py")


def run_isolated(action: str, path: Path) -> subprocess.CompletedProcess[bytes]:
    """Run ``isolated_reader.py`` on a file, with captured output."""
    command = [sys.executable, "-P", str(_PROGRAM), action, str(path.absolute())]
    return subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, check=False)


def check_readable_by_gmsh(path: Path, called: Path) -> None:
    """Raise ``MeshError``, which names ``called``, for an MSH file on which gmsh crashes."""
    if (code := run_isolated("msh", path).returncode) < 0:
        end = signal.Signals(-code).name
        raise MeshError(f"{called}: gmsh cannot read it: it crashed ({end})", "Is the file complete?")
