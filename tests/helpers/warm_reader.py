"""The reader's program in forks of a process that has loaded its libraries: a start of it takes half a second.

That process is started once. It has one thread, neither MPI nor PETSc, and does nothing else: forks of a process with
threads may wait forever for a lock that one of them held.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hpcinv.base import reading
from hpcinv.mesh.io import isolated

PROGRAM = str(Path(reading.__file__).with_name("isolated_reader.py"))
LIBRARIES = (
    *("vtkmodules.vtkIOXML", "vtkmodules.vtkIOGeometry", "vtkmodules.vtkIOPLY", "vtkmodules.vtkIOLegacy", "h5py"),
    *("gmsh", "hpcinv.base.reading.voxel_files", "hpcinv.base.reading.surfaces", "hpcinv.base.reading.nifti"),
)
SERVER = f"""
import contextlib, importlib, importlib.util, json, os, socket, sys

channel, program = socket.socket(fileno=int(sys.argv[1])), sys.argv[2]
spec = importlib.util.spec_from_file_location("isolated_reader", program)
reader = importlib.util.module_from_spec(spec)
spec.loader.exec_module(reader)
for name in {LIBRARIES!r}:
    with contextlib.suppress(ImportError):
        importlib.import_module(name)
while True:
    message, descriptors, _, _ = socket.recv_fds(channel, 1 << 16, 2)
    if not message:
        break
    variables, *arguments = json.loads(message)
    if (child := os.fork()) == 0:
        channel.close()
        os.environ.clear()
        os.environ.update(variables)
        for number, descriptor in enumerate(descriptors, start=1):
            os.dup2(descriptor, number)
        try:
            reader.main(*arguments)
        except BaseException:
            sys.excepthook(*sys.exc_info())
            os._exit(1)
        sys.stderr.flush()
        os._exit(0)
    for descriptor in descriptors:
        os.close(descriptor)
    _, status = os.waitpid(child, 0)
    channel.sendall(str(os.waitstatus_to_exitcode(status)).encode())
"""
PATIENCE = 120.0
"""Seconds until an answer of the process; slow readings fail if it is lowered."""


class WarmReader:
    """Replacement of `isolated.run_isolated`; `run` replaces what starts other commands of the reader."""

    def __init__(self) -> None:
        self._channel, theirs = socket.socketpair()
        self._channel.settimeout(PATIENCE)
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-P", "-c", SERVER, str(theirs.fileno()), PROGRAM]
        self._process = subprocess.Popen(command, env=environment, pass_fds=[theirs.fileno()])
        theirs.close()

    def __call__(self, action: str, path: Path, receive: Any = None) -> subprocess.CompletedProcess[bytes]:
        return self.run(isolated._command(action, path)[0], receive=receive)

    def run(self, command: list[str], *, receive: Any = None, **_: Any) -> subprocess.CompletedProcess[bytes]:
        """Run a command of the reader; replacement of `run_child` and of `subprocess.run`."""
        with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
            message = json.dumps([dict(os.environ), *command[-4:]])  # action, path, limits
            socket.send_fds(self._channel, [message.encode()], [output.fileno(), errors.fileno()])
            code = int(self._channel.recv(64))
            output.seek(0)
            errors.seek(0)
            if receive is not None:
                receive(output)
            return subprocess.CompletedProcess(command, code, output.read(), errors.read())

    def close(self) -> None:
        """End the process."""
        with contextlib.suppress(OSError):
            self._channel.close()
        self._process.wait(PATIENCE)
