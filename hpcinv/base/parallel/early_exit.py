"""Errors for code of a job that ends the process with code 0 before the command is done."""

import os
import sys
from collections.abc import Callable
from typing import Any

_ADVICE = "  Code of a job must return, or raise an error.\n"
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


def _complain(text: str) -> None:
    os.write(2, f"{text}\n{_ADVICE}".encode())
