"""Mesh files read in a separate process, because VTK and gmsh may crash on damaged files."""

import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hpcinv.errors import MeshError, OutputError
from hpcinv.job.fingerprint import file_digest
from hpcinv.parallel.children import run_child
from hpcinv.parallel.signals import ended_by_signals

_PROGRAM = Path(__file__).with_name("isolated_reader.py")


def run_isolated(action: str, path: Path) -> subprocess.CompletedProcess[bytes]:
    """Run ``isolated_reader.py`` on a file, with captured output."""
    with ended_by_signals():
        return run_child([sys.executable, "-P", str(_PROGRAM), action, str(path.absolute())])


def check_readable_by_gmsh(path: Path, called: Path) -> None:
    """Raise ``MeshError``, which names ``called``, for an MSH file on which gmsh crashes.

    That takes as long as reading the file. So a record beside the kernels tells which files gmsh has read.
    """
    records, name = _records(), f"msh_{file_digest(called)}_{version('gmsh')}"
    if records is not None and records.read_record(name, records.DIRECTORY) is not None:
        return
    if (code := run_isolated("msh", path).returncode) < 0:
        end = signal.Signals(-code).name
        raise MeshError(f"{called}: gmsh cannot read it: it crashed ({end})", "Is the file complete?")
    if records is not None:
        records.write_record(name, "gmsh reads it", records.DIRECTORY)


def _records() -> Any:
    """Return the module that keeps records, ``None`` if it refuses its directory: reading a mesh needs no kernels."""
    try:
        from hpcinv.parallel import jit
    except OutputError:
        return None
    return jit
