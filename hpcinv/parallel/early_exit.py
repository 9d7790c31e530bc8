"""Error for code of a job that exits the process with code 0 before the command is done."""

import os
import sys
from typing import NoReturn


def refuse_exit_without_end() -> None:
    """Make ``os._exit(0)`` in a plugin or mesh generator exit with code 1 and a message.

    Forked processes are not affected.
    """
    process, original = os.getpid(), os._exit

    def exit_with_message(status: int) -> NoReturn:
        if os.getpid() == process and status == 0:
            caller = sys._getframe(1)
            where = f"{caller.f_code.co_filename}, line {caller.f_lineno}"
            text = f"{where}: os._exit(0) has ended the process before the command was done\n"
            os.write(2, f"{text}  Code of a job must return, or raise an error.\n".encode())
            status = 1
        original(status)

    os._exit = exit_with_message
