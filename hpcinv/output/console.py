"""Consoles that handle a closed pipe, as in ``hpcinv laws | head``."""

import rich.console

from hpcinv.parallel.signals import discard_output


class Console(rich.console.Console):
    """Console of commands that only print: raises ``BrokenPipeError`` when the pipe is closed."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


class RunConsole(rich.console.Console):
    """Console of a run, which continues when the pipe is closed, since its results are files."""

    def on_broken_pipe(self) -> None:
        self.quiet = True
        discard_output()


class ForwardedConsole(RunConsole):
    """Console of a run under mpirun: it never hides the cursor, which a killed run could not show again."""

    def show_cursor(self, show: bool = True) -> bool:
        return False
