"""Signals to a run: one asks it to save and stop, Ctrl-C ends it where it is.

Python calls a handler when the main thread is back from whatever library it is in. While gmsh makes a mesh that can
take hours, so a thread also waits for signals: it ends a run that has nothing to save yet, and one that is interrupted.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn


class StopRequest:
    """Whether SIGTERM or SIGUSR1 has arrived on this rank; all ranks agree on it at the next Newton iteration."""

    def __init__(self) -> None:
        self.signal: signal.Signals | None = noted_while_starting()

    def install(self) -> None:
        """Only note the signals from now on.

        Once before MPI starts, since some launchers keep handlers that come later from being called, and again when
        the stack is loaded, since PETSc puts a handler of its own on SIGTERM, which kills.
        """
        for number in (signal.SIGTERM, signal.SIGUSR1):
            signal.signal(number, self._note)
        _watch()

    def ends_libraries_by(self, end: Callable[[], NoReturn] | None) -> None:
        """What a signal does that arrives within ``ended_by_signals``; ``None`` leaves it at a note."""
        global _end
        _end = end
        _stop_requests[:] = [self]

    def ignore(self) -> None:
        """No longer even note them: the run is over, and Python's own end would let a late one kill it."""
        for number in (signal.SIGTERM, signal.SIGUSR1):
            signal.signal(number, signal.SIG_IGN)

    def __call__(self) -> bool:
        return self.signal is not None

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.signal = signal.Signals(number)


_stop_requests: list[StopRequest] = []  # the one that has a say in what follows
_end: Callable[[], NoReturn] | None = None
_interrupt: Callable[[], NoReturn] | None = None
_in_library = False
_watcher: threading.Thread | None = None
_GRACE = 0.2  # seconds for the main thread to handle a signal itself


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Let SIGTERM and SIGUSR1 end the run in this block at once, although a library does not return; nothing is saved.

    The library must release Python's interpreter lock, as all do that are called by ctypes.
    """
    global _in_library
    before, _in_library = _in_library, True
    try:
        if _end is not None and any(stop() for stop in _stop_requests):
            _end()
        yield
    finally:
        _in_library = before


def _watch() -> None:
    """Start the thread that waits for signals, once."""
    global _watcher
    if _watcher is None and threading.current_thread() is threading.main_thread():
        read_end, write_end = os.pipe()
        os.set_blocking(write_end, False)
        signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
        _watcher = threading.Thread(target=_wait_for_signals, args=(read_end,), name="signals", daemon=True)
        _watcher.start()


def _wait_for_signals(read_end: int) -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # the main thread gets them, or puts them off
    while received := os.read(read_end, 1):
        time.sleep(_GRACE)
        if received[0] == signal.SIGINT:
            if _interrupt is not None:
                _interrupt()
            elif _in_library:
                os._exit(130)
        elif _in_library and _end is not None:
            _end()


_LAUNCHED = ("PMI_RANK", "PMI_ID", "PMIX_RANK", "OMPI_COMM_WORLD_RANK", "SLURM_PROCID")


def note_while_starting() -> None:
    """Note signals from now on, until it is known what this process is to do.

    A rank that ended now would leave the others waiting for it in MPI's own start, for ever.
    """
    for number in (signal.SIGTERM, signal.SIGUSR1, signal.SIGINT):
        signal.signal(number, _note_start)


def noted_while_starting() -> signal.Signals | None:
    return signal.Signals(_noted[0]) if _noted else None


def starting_is_over() -> None:
    """End this process if it was asked to, unless it is a rank, which then agrees with the others (`launch`)."""
    if any(name in os.environ for name in _LAUNCHED) or signal.getsignal(signal.SIGTERM) is not _note_start:
        return
    for number in (signal.SIGTERM, signal.SIGUSR1):
        signal.signal(number, _end_at_once)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if _noted:
        _end_at_once(_noted[0], None)
    global _end
    _end = lambda: os._exit(STOPPED)  # noqa: E731
    _watch()


def exit_code_of(number: int) -> int:
    """What a process ends with that a signal has ended."""
    return 130 if number == signal.SIGINT else STOPPED


def _note_start(number: int, _frame: FrameType | None) -> None:
    _noted.append(number)


def _end_at_once(number: int, _frame: FrameType | None) -> NoReturn:
    os._exit(exit_code_of(number))


_noted: list[int] = []

STOPPED = 75
"""exit code of a run that a signal has stopped (``EX_TEMPFAIL``)"""

CLOSED_OUTPUT = 141
"""exit code where the reader of a pipe has gone, as a shell gives it for SIGPIPE"""


def discard_output() -> None:
    """Let what is printed from now on go nowhere, since nobody reads it: not even Python's end can then fail by it."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.__stdout__.fileno() if sys.__stdout__ else 1)
    os.close(nowhere)


def end_on_interrupt(end: Callable[[], NoReturn]) -> None:
    """Let Ctrl-C end the run by ``end``: a KeyboardInterrupt would get lost in PETSc, which calls back into Python."""
    global _interrupt
    _interrupt = end
    signal.signal(signal.SIGINT, lambda _number, _frame: end())


@contextmanager
def handlers_kept() -> Iterator[None]:
    """Undo what a library does in this block to signals that Python handles, behind its back; they wait meanwhile."""
    handled = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGUSR1, signal.SIGINT)}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, handled)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            for number, handler in handled.items():
                if callable(handler):
                    signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
