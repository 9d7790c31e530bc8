"""The reader's program in forks of this process, which has loaded its libraries: a start takes half a second."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import tempfile
import traceback
import warnings
from pathlib import Path
from typing import Any

from hpcinv.mesh.io import isolated

LIBRARIES = ("vtkmodules.vtkIOXML", "vtkmodules.vtkIOGeometry", "vtkmodules.vtkIOPLY", "vtkmodules.vtkIOLegacy")
PACKAGES = (
    "pydicom",
    "SimpleITK",
    "hpcinv.base.reading.nifti",
    "hpcinv.base.reading.voxel_files",
    "hpcinv.base.reading.surfaces",
)
MEMORY, SECONDS, PATIENCE = 2 << 30, 20, 60
"""limits of the forks: bytes, seconds of processor time, and on the clock"""
RUN_ISOLATED = isolated.run_isolated


def load_libraries() -> None:
    """Load what the forks need; packages that are not installed are reported by the reader."""
    for name in (*LIBRARIES, *PACKAGES):
        try:
            importlib.import_module(name)
        except ImportError:
            continue


def run_forked(action: str, path: Path, receive: Any = None) -> subprocess.CompletedProcess[bytes]:
    """Replacement of `isolated.run_isolated`; ``AssertionError`` if the program prints a traceback."""
    from hpcinv.base.reading.isolated_reader import main

    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors, warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads, which do nothing here
        if (process := os.fork()) == 0:
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(PATIENCE)
            os.dup2(output.fileno(), 1)
            os.dup2(errors.fileno(), 2)
            try:
                main(action, str(path), str(MEMORY), str(SECONDS))
            except BaseException:
                traceback.print_exc()
                os._exit(1)
            os._exit(0)
        _, status = os.waitpid(process, 0)
        if os.WIFSIGNALED(status):  # maybe at a lock of a thread that a fork does not have
            return RUN_ISOLATED(action, path, receive)
        output.seek(0)
        errors.seek(0)
        receive(output)
        printed = errors.read()
    if b"Traceback" in printed:
        raise AssertionError(printed.decode())
    return subprocess.CompletedProcess([], os.waitstatus_to_exitcode(status), None, printed)
