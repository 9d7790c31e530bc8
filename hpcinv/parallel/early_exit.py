"""Code of a job that ends the process with exit code 0 before the command is done: that is no success."""

from __future__ import annotations

import os
import sys
from typing import NoReturn


def refuse_exit_without_end() -> None:
    """Let ``os._exit(0)``, from a plugin or a mesh generator, end this process with exit code 1 and a message.

    Processes that this one forks may end as they like.
    """
    ours, end = os.getpid(), os._exit

    def exit_with_message(status: int) -> NoReturn:
        if os.getpid() == ours and status == 0:
            caller = sys._getframe(1)
            where = f"{caller.f_code.co_filename}, line {caller.f_lineno}"
            text = f"{where}: os._exit(0) has ended the process before the command was done\n"
            os.write(2, f"{text}  Code of a job must return, or raise an error.\n".encode())
            status = 1
        end(status)

    os._exit = exit_with_message
