"""Child processes: they survive signals that ask this process to stop, and end whenever it ends.

A launcher sends a signal to all processes of a group. This process saves and stops when it is asked to (`signals`); a
child that ended at once would be taken for one that has failed.
"""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from typing import IO

from hpcinv.base.parallel.signals import ASK_TO_STOP, signals_blocked

# It imports little, since each kernel waits for it: 20 ms. exec keeps ignored signals; Python adds two of them.
_LAUNCH = f"""
import ctypes, os, sys
parent, processors, ignored, command = int(sys.argv[1]), sys.argv[2], sys.argv[3], sys.argv[4:]
system = ctypes.CDLL(None)
system.signal({signal.SIGPIPE:d}, None), system.signal({signal.SIGXFSZ:d}, None)
for number in map(int, ignored.split()):
    system.signal(number, ctypes.c_void_p(1))  # SIG_IGN
if sys.platform == "linux":
    system.prctl(1, {signal.SIGKILL:d})  # PR_SET_PDEATHSIG
    if processors:
        os.sched_setaffinity(0, map(int, processors.split()))
if os.getppid() != parent:
    sys.exit(1)
try:
    os.execvp(command[0], command)
except OSError as error:
    sys.exit(f"{{command[0]}}: {{error.strerror}}")
"""


def ending_with_this(
    command: Sequence[str], *, processors: Iterable[int] = (), ignored: Iterable[signal.Signals] = ()
) -> list[str]:
    """Return a command for `command` in a process that is killed when the calling thread ends (on Linux).

    Args:
        processors: those it may use; by default this process's.
        ignored: signals that it ignores.
    """
    lists = (" ".join(f"{number:d}" for number in numbers) for numbers in (processors, ignored))
    return [sys.executable, "-I", "-S", "-c", _LAUNCH, str(os.getpid()), *lists, *command]


def start_child(command: Sequence[str], *, keeps_output: bool = True) -> subprocess.Popen[bytes]:
    """Start a child process for `run_child`, with no input and captured errors; requests to stop do not reach it.

    It stays in the group of this process, so that Ctrl-C and the end of a job reach what it starts itself as well.

    Args:
        keeps_output: whether its output is captured too.

    Raises:
        OSError: no process can be started.
    """
    # Blocked for gmsh, which sets handlers, and until they are ignored; ignored for shells, which may unblock them.
    with signals_blocked(ASK_TO_STOP):
        return subprocess.Popen(
            ending_with_this(command, ignored=ASK_TO_STOP),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE if keeps_output else subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )


def run_child(
    command: Sequence[str],
    *,
    keeps_output: bool = True,
    receive: Callable[[IO[bytes]], None] | None = None,
    seconds: float | None = None,
    started: subprocess.Popen[bytes] | None = None,
) -> subprocess.CompletedProcess[bytes]:
    """Run a child process to its end.

    Args:
        keeps_output: as for `start_child`.
        receive: called with its output instead, to read it without a second copy in memory.
        seconds: on the clock after which it is killed.
        started: the process, if `start_child` has started it already.

    Raises:
        OSError: no process can be started.
    """
    child = started or start_child(command, keeps_output=keeps_output)
    killer = threading.Timer(seconds, child.kill) if seconds is not None else None
    with child:
        try:
            if killer is not None:
                killer.start()
            output, errors = _received(child, receive) if receive is not None else child.communicate()
        except BaseException:
            child.kill()
            raise
        finally:
            if killer is not None:
                killer.cancel()
    return subprocess.CompletedProcess(command, child.returncode, output, errors)


def _received(child: subprocess.Popen[bytes], receive: Callable[[IO[bytes]], None]) -> tuple[None, bytes]:
    """Hand over the output of a process to its end, and return what it writes as errors."""
    assert child.stdout is not None
    assert child.stderr is not None
    errors = list[bytes]()
    # At the same time, since a pipe that nobody reads stops the process.
    other = threading.Thread(target=lambda stream: errors.append(stream.read()), args=(child.stderr,))
    other.start()
    try:
        receive(child.stdout)
    finally:
        child.stdout.close()  # a process that writes more ends
        other.join()
    child.wait()
    return None, b"".join(errors)
