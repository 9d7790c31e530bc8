"""Server of forks for `helpers.forks`: it imports the stack once, without starting MPI, and runs commands in forks.

Usage: ``python -P fork_server.py DIRECTORY`` listens on DIRECTORY/socket until its standard input is closed.
"""

from __future__ import annotations

import contextlib
import fcntl
import gc
import importlib
import marshal
import os
import pkgutil
import runpy
import select
import signal
import socket
import struct
import sys
from pathlib import Path
from typing import Any, NoReturn

FIRST_FREE = 100  # file numbers below may be asked for by a command
PROGRAMS = ("hpcinv.__main__", "hpcinv.batch.groupprocess")
"""modules that do more than define names when they are imported"""


def load_stack() -> None:
    """Import all that commands import, without ``MPI_Init`` and ``PetscInitialize``: each fork starts its own."""
    import mpi4py

    mpi4py.rc.initialize, mpi4py.rc.finalize = False, True
    from mpi4py import MPI

    is_initialized: Any = MPI.Is_initialized
    MPI.Is_initialized = lambda: True
    import hpcinv.parallel.ranks

    MPI.Is_initialized = is_initialized
    if importlib.util.find_spec("dolfinx_solver"):
        importlib.import_module("dolfinx_solver")
    petsc = importlib.import_module("petsc4py.lib").ImportPETSc(None)
    log, petsc.Log = petsc.Log, _ActiveLog
    import hpcinv.parallel.runtime

    petsc.Log = log
    import hpcinv

    for module in pkgutil.walk_packages(hpcinv.__path__, "hpcinv."):
        if module.name not in PROGRAMS:
            with contextlib.suppress(ImportError):  # of a package that is not installed
                importlib.import_module(module.name)
    if MPI.Is_initialized():
        sys.exit("MPI was started by an import, and forks of this process could not start it")
    if len(list(Path("/proc/self/task").iterdir())) > 1:
        sys.exit("an import has started threads, which forks would not have")


class _ActiveLog:
    @staticmethod
    def isActive() -> bool:
        """Stand in for PETSc's log, which cannot begin before PETSc does."""
        return True


def start_mpi() -> None:
    """Do what the imports of `hpcinv.parallel.ranks` and `hpcinv.parallel.runtime` do in a process of its own."""
    from hpcinv.parallel import ranks
    from hpcinv.parallel.signals import handlers_kept

    petsc: Any = sys.modules["petsc4py.PETSc"]
    ranks._prepare_environment()
    ranks._start_mpi()
    with handlers_kept():
        petsc._initialize()
    petsc.Log.begin()


def serve(directory: str) -> list[str] | None:
    """Fork for each request until standard input is closed; return the arguments of a command in its fork."""
    listener = socket.socket(socket.AF_UNIX)
    os.chdir(directory)
    listener.bind("socket")
    listener.listen(64)
    base = [path for path in sys.path if path not in os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for them
    gc.collect()
    gc.freeze()
    print("ready", flush=True)
    while True:
        ready, _, _ = select.select([listener.fileno(), 0], [], [])
        if 0 in ready:
            return None
        connection, _ = listener.accept()
        if os.fork() == 0:
            listener.close()
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            return attend(connection, base)
        connection.close()


def attend(connection: socket.socket, base: list[str]) -> list[str]:
    """Run one request in a child of this process, whose arguments are returned there; this process ends with it."""
    head, files, _, _ = socket.recv_fds(connection, 8, 8)
    (size,) = struct.unpack("q", head)
    received = b""
    while len(received) < size and (part := connection.recv(size - len(received))):
        received += part
    request: dict[str, Any] = marshal.loads(received)
    child = os.fork()
    if child != 0:
        for file in files:
            os.close(file)
        watch(child, connection)
    connection.close()
    os.setpgid(0, 0)
    adopt(request, files, base)
    return [os.fsdecode(word) for word in request["arguments"]]


def adopt(request: dict[str, Any], files: list[int], base: list[str]) -> None:
    """Give this process what the stand-in had: working directory, open files, environment, signals, processors."""
    place, *files = [fcntl.fcntl(file, fcntl.F_DUPFD_CLOEXEC, FIRST_FREE) for file in files]
    for file, number in zip(files, request["files"], strict=True):
        os.dup2(file, number)
        os.close(file)
    os.fchdir(place)
    os.environb.clear()
    os.environb.update(request["environment"])
    os.sched_setaffinity(0, request["processors"])
    for number in request["ignored"]:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_SETMASK, request["blocked"])
    with contextlib.suppress(OSError):  # it was removed
        sys.path[:] = [str(Path.cwd()), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep)), *base]
    settings = {"stdin": (0, "r", -1, None), "stdout": (1, "w", -1, None), "stderr": (2, "w", 1, "backslashreplace")}
    for name, (number, mode, buffering, errors) in settings.items():
        setattr(sys, name, os.fdopen(number, mode, buffering, errors=errors, closefd=False))
        setattr(sys, f"__{name}__", getattr(sys, name))


def watch(child: int, connection: socket.socket) -> NoReturn:
    """Forward signals to the fork and its exit code to the stand-in; if the stand-in has gone, kill the fork."""
    ending = os.pidfd_open(child)
    while True:
        ready, _, _ = select.select([ending, connection.fileno()], [], [])
        if ending in ready:
            code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            with contextlib.suppress(OSError):
                connection.sendall(struct.pack("i", code))
            os._exit(0)
        numbers = connection.recv(16)
        for number in numbers:
            os.kill(child, number)
        if not numbers:
            with contextlib.suppress(OSError):
                os.killpg(child, signal.SIGKILL)
            os._exit(0)


def main() -> None:
    """Serve, or run a command in a fork."""
    load_stack()
    arguments = serve(sys.argv[1])
    if arguments is None:
        os._exit(0)
    sys.argv = arguments
    start_mpi()
    runpy.run_module(arguments[0], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
