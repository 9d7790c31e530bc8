"""Mesh files read in a separate process, because VTK and gmsh may crash on damaged files."""

import hashlib
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

from hpcinv.errors import MeshError
from hpcinv.parallel.jit import DIRECTORY, read_record, write_record

_PROGRAM = Path(__file__).with_name("isolated_reader.py")


def run_isolated(action: str, path: Path) -> subprocess.CompletedProcess[bytes]:
    """Run ``isolated_reader.py`` on a file, with captured output."""
    command = [sys.executable, "-P", str(_PROGRAM), action, str(path.absolute())]
    return subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, check=False)


def check_readable_by_gmsh(path: Path, called: Path) -> None:
    """Raise ``MeshError``, which names ``called``, for an MSH file on which gmsh crashes.

    That takes as long as to read the file, so that a record beside the kernels tells of the files that were read.
    """
    with path.open("rb") as file:
        record = f"msh_{hashlib.file_digest(file, 'sha256').hexdigest()}_{version('gmsh')}"
    if read_record(record, DIRECTORY) is not None:
        return
    if (code := run_isolated("msh", path).returncode) < 0:
        end = signal.Signals(-code).name
        raise MeshError(f"{called}: gmsh cannot read it: it crashed ({end})", "Is the file complete?")
    write_record(record, "gmsh reads it", DIRECTORY)
