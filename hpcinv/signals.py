"""Signals to a run: one asks it to save and stop, Ctrl-C ends it where it is."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn


class StopRequest:
    """Whether SIGTERM or SIGUSR1 has arrived on this rank; all ranks agree on it at the next Newton iteration."""

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None

    def install(self) -> None:
        """Only note the signals from now on.

        Once before MPI starts, since some launchers keep handlers that come later from being called, and again when
        the stack is loaded, since PETSc puts a handler of its own on SIGTERM, which kills.
        """
        for number in (signal.SIGTERM, signal.SIGUSR1):
            signal.signal(number, self._note)

    def ignore(self) -> None:
        """No longer even note them: the run is over, and Python's own end would let a late one kill it."""
        for number in (signal.SIGTERM, signal.SIGUSR1):
            signal.signal(number, signal.SIG_IGN)

    def __call__(self) -> bool:
        return self.signal is not None

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.signal = signal.Signals(number)


CLOSED_OUTPUT = 141
"""exit code where the reader of a pipe has gone, as a shell gives it for SIGPIPE"""


def discard_output() -> None:
    """Let what is printed from now on go nowhere, since nobody reads it: not even Python's end can then fail by it."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.__stdout__.fileno() if sys.__stdout__ else 1)
    os.close(nowhere)


def end_on_interrupt(end: Callable[[], NoReturn]) -> None:
    """Let Ctrl-C end the run by ``end``: a KeyboardInterrupt would get lost in PETSc, which calls back into Python."""
    signal.signal(signal.SIGINT, lambda _number, _frame: end())


@contextmanager
def handlers_kept() -> Iterator[None]:
    """Undo what a library does in this block to signals that Python handles, behind Python's back."""
    handled = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGUSR1, signal.SIGINT)}
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            for number, handler in handled.items():
                if callable(handler):
                    signal.signal(number, handler)
