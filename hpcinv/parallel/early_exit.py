"""Errors for code of a job that ends the process with code 0 before the command is done."""

import ctypes
import os
import signal
import sys
from collections.abc import Callable
from typing import Any

_ADVICE = "  Code of a job must return, or raise an error.\n"
_KILL_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl
_CODE = 1  # exit code of these errors


def refuse_exit_without_end() -> None:
    """Make ``os._exit(0)`` and ``os.exec…`` in a plugin or mesh generator exit with code 1 and a message.

    Forked processes are not affected.
    """
    process, leave = os.getpid(), os._exit

    def refusing(name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        def ends(*arguments: Any) -> Any:
            if os.getpid() != process or (name == "_exit" and arguments != (0,)):
                return original(*arguments)
            caller = sys._getframe()
            while caller.f_back and caller.f_globals["__name__"] in (__name__, "os"):
                caller = caller.f_back
            call = "os._exit(0)" if name == "_exit" else f"os.{name}"
            where = f"{caller.f_code.co_filename}, line {caller.f_lineno}"
            _complain(f"{where}: {call} has ended the process before the command was done")
            return leave(_CODE)

        return ends

    for name in ("_exit", "execv", "execve"):  # os.execl and others call these
        setattr(os, name, refusing(name, getattr(os, name)))


class ProvenEnd:
    """Proof by a child process that its command was done: it shows an exit in C too, which no code in it can see."""

    def __init__(self) -> None:
        self._read_end, self._write_end = os.pipe()

    def start(self) -> int:
        """Fork.

        Returns:
            0 in the child, which goes on and ends with this process (on Linux); its number in this process.
        """
        sys.stdout.flush()
        parent = os.getpid()
        if child := os.fork():
            os.close(self._write_end)
            return child
        os.close(self._read_end)
        if sys.platform == "linux":
            ctypes.CDLL(None).prctl(_KILL_WITH_PARENT, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(_CODE)
        return 0

    def prove(self) -> None:
        """Say in the child that the command is done."""
        os.write(self._write_end, b"1")

    def wait(self, child: int) -> int:
        """Return the exit code of the child, in its parent; an error if it is 0 without proof."""
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        os.set_blocking(self._read_end, False)
        try:
            is_done = bool(os.read(self._read_end, 1))
        except BlockingIOError:  # a process that code of the job has started holds the other end
            is_done = False
        if code < 0:
            _complain(f"{signal.Signals(-code).name} has ended the process before the command was done")
            return 128 - code
        if code == 0 and not is_done:
            _complain("code of the job has ended the process with exit code 0 before the command was done")
            return _CODE
        return code


def _complain(text: str) -> None:
    os.write(2, f"{text}\n{_ADVICE}".encode())
