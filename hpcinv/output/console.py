"""Consoles for what is printed where somebody may stop reading, as ``hpcinv laws | head`` does."""

from __future__ import annotations

import rich.console

from hpcinv.parallel.signals import discard_output


class Console(rich.console.Console):
    """Of commands that do nothing but print: raises ``BrokenPipeError`` when nobody reads any more."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


class RunConsole(rich.console.Console):
    """Of a run, which goes on without it: its results are files."""

    def on_broken_pipe(self) -> None:
        self.quiet = True
        discard_output()


class ForwardedConsole(RunConsole):
    """Of a run whose terminal others write to: it keeps its cursor, which a run that is killed could not give back."""

    def show_cursor(self, show: bool = True) -> bool:
        return False
