"""Signals to a run: SIGTERM and SIGUSR1 ask it to save and stop, SIGINT (Ctrl-C) ends it immediately.

Python calls a handler only after the main thread has returned from a library, which may take hours while gmsh makes a
mesh. So a thread also waits for signals: it ends runs that have nothing to save yet, and interrupted runs.
"""

import math
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

ASK_TO_STOP = (signal.SIGTERM, signal.SIGUSR1)
"""signals that ask a run to save and stop"""


class StopRequest:
    """Request to stop by SIGTERM or SIGUSR1 on this rank; all ranks agree on it at the next Newton iteration."""

    def __init__(self) -> None:
        self.signal: signal.Signals | None = signal.Signals(_noted[0]) if _noted else None

    def install(self) -> None:
        """Install handlers that record the signals.

        Called before MPI starts, because with some launchers later handlers are not called, and again after the stack
        is loaded, because PETSc installs a handler of SIGTERM that ends the process.
        """
        for number in ASK_TO_STOP:
            signal.signal(number, self._note)
        _watch()

    def set_end_in_library(self, end: Callable[[], NoReturn] | None) -> None:
        """Set the function that a signal calls within ``ended_by_signals``; ``None`` only records the signal.

        Signals that arrived before count only where their handlers recorded them: another command of this process may
        have had them.
        """
        global _end
        with _noting:
            while _arrived is not None and _next_signal(_arrived):
                pass
            _end = end
            _stop_requests[:] = [self]

    def ignore(self) -> None:
        """Ignore the signals: the run is over, and a late signal could end the process during the exit of Python.

        What the program does next in a library, it does for itself: an earlier signal does not end that either.
        """
        global _end
        for number in ASK_TO_STOP:
            signal.signal(number, signal.SIG_IGN)
        with _noting:
            if self in _stop_requests:
                _stop_requests.clear()
                _end = None

    def __call__(self) -> bool:
        """Return whether a signal has arrived."""
        return self.signal is not None

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.signal = signal.Signals(number)


_stop_requests: list[StopRequest] = []  # the current one
_end: Callable[[], NoReturn] | None = None
_interrupt: Callable[[], NoReturn] | None = None
_is_in_library = False
_watcher: threading.Thread | None = None
_arrived: int | None = None  # end of a pipe from which the signals are read
_noting = threading.Lock()  # a signal is noted before a command begins, or within it
_HANDLED = (*ASK_TO_STOP, signal.SIGINT)
_GRACE = 0.2  # seconds for the main thread to handle a signal itself


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Context in which SIGTERM and SIGUSR1 end the run immediately, within calls of a library; nothing is saved.

    The library must release the interpreter lock of Python, as all libraries called by ctypes do.
    """
    global _is_in_library
    kept_flag, _is_in_library = _is_in_library, True
    try:
        if _end is not None and any(stop() for stop in _stop_requests):
            _end()
        yield
    finally:
        _is_in_library = kept_flag


@contextmanager
def signals_recorded() -> Iterator[None]:
    """Context in which SIGTERM and SIGUSR1 end no call of a library, since there is something to save."""
    global _end
    kept_end, _end = _end, None
    try:
        yield
    finally:
        _end = kept_end


PATIENCE = 8.0
"""seconds that a check has to stop by itself after a signal; raised, a process may be killed that has 10 s to end"""


class _LateEnd:
    """Function that ends the process late, and the time at which it is due after a signal."""

    def __init__(self, end: Callable[[], None] | None) -> None:
        self.end = end
        self.due = math.inf

    def set_due(self) -> None:
        self.due = min(self.due, time.monotonic() + PATIENCE)

    def call_if_due(self) -> None:
        if time.monotonic() >= self.due:
            self.due = math.inf
            if self.end is not None:
                self.end()


_late_end = _LateEnd(None)  # of the present context


@contextmanager
def ended_late(end: Callable[[], None] | None) -> Iterator[None]:
    """Context in which ``end`` is called some seconds after SIGTERM or SIGUSR1, by the thread that waits for signals.

    Only signals within the context count, and ``end`` is not called after it.

    Args:
        end: must end the process, while the main thread is in a library; ``None`` never ends it.
    """
    global _late_end
    kept_end, _late_end = _late_end, _LateEnd(end)
    try:
        yield
    finally:
        _late_end = kept_end


def _watch() -> None:
    """Start the thread that waits for signals, if it is not running."""
    global _watcher, _arrived
    if _watcher is None and threading.current_thread() is threading.main_thread():
        _arrived, write_end = os.pipe()
        for end in (_arrived, write_end):
            os.set_blocking(end, False)
        signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
        _watcher = threading.Thread(target=_wait_for_signals, args=(_arrived,), name="signals", daemon=True)
        _watcher.start()


def _next_signal(arrived: int) -> bytes | None:
    """Return the number of the next signal to note; ``None`` without one, nothing at the end of the pipe."""
    try:
        return os.read(arrived, 1)
    except BlockingIOError:
        return None


def _wait_for_signals(arrived: int) -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # signals go to the main thread
    while True:
        due = _late_end.due  # the thread that waits must not keep the object, which knows the whole run
        left = None if due == math.inf else max(0.0, due - time.monotonic())
        if not select.select([arrived], [], [], left)[0]:
            _late_end.call_if_due()
            continue
        with _noting:
            received, asked = _next_signal(arrived), list(_stop_requests)
            if received and received[0] in ASK_TO_STOP:
                _late_end.set_due()
        if received is None:  # it was for an earlier command
            continue
        if not received:
            return
        time.sleep(_GRACE)
        if asked == _stop_requests:
            _end_in_library(received[0])


def _end_in_library(number: int) -> None:
    """End the process for a signal that the main thread has not handled."""
    if number == signal.SIGINT:
        if _interrupt is not None:
            _interrupt()
        elif _is_in_library:
            os._exit(130)
    elif _is_in_library and _end is not None:
        _end()


_LAUNCHED = ("PMI_RANK", "PMI_ID", "PMIX_RANK", "OMPI_COMM_WORLD_RANK", "SLURM_PROCID")


def note_while_starting() -> None:
    """Record signals until the command of this process is known.

    If a rank ended during start-up, the others would wait for it forever in the start of MPI.
    """
    for number in _HANDLED:
        signal.signal(number, _note_start)


def end_if_noted() -> None:
    """End this process if a signal was recorded; not a rank of MPI, which agrees with the others (`launch`).

    Later signals end the process immediately.
    """
    if any(name in os.environ for name in _LAUNCHED) or signal.getsignal(signal.SIGTERM) is not _note_start:
        return
    for number in ASK_TO_STOP:
        signal.signal(number, _end_at_once)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if _noted:
        _end_at_once(_noted[0], None)
    global _end
    _end = lambda: os._exit(STOPPED)  # noqa: E731
    _watch()


def exit_code_of(number: int) -> int:
    """Exit code of a process that a signal has ended."""
    return 130 if number == signal.SIGINT else STOPPED


def _note_start(number: int, _frame: FrameType | None) -> None:
    _noted.append(number)


def _end_at_once(number: int, _frame: FrameType | None) -> NoReturn:
    os._exit(exit_code_of(number))


_noted: list[int] = []

STOPPED = 75
"""exit code of a run that a signal has stopped (``EX_TEMPFAIL``)"""

CLOSED_OUTPUT = 141
"""exit code if the reader of a pipe has ended, as in a shell for SIGPIPE"""


def discard_output() -> None:
    """Redirect standard output to the null device, after its reader has ended: later output then cannot fail."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.__stdout__.fileno() if sys.__stdout__ else 1)
    os.close(nowhere)


def end_on_interrupt(end: Callable[[], NoReturn]) -> None:
    """Call ``end`` for Ctrl-C: a KeyboardInterrupt would be lost in Python functions called by PETSc."""
    global _interrupt
    _interrupt = end
    signal.signal(signal.SIGINT, lambda _number, _frame: end())


@contextmanager
def handlers_kept() -> Iterator[None]:
    """Context in which signals wait, and after which the signal handlers of Python are restored."""
    with signals_blocked(_HANDLED), handlers_restored():
        yield


@contextmanager
def signals_blocked(numbers: Iterable[int]) -> Iterator[None]:
    """Context in which signals wait; processes that are started in it never get them."""
    kept_mask = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, kept_mask)


@contextmanager
def handlers_restored() -> Iterator[None]:
    """Context after which the signal handlers of Python are restored; in it, signals reach a library's handlers."""
    handled = {number: signal.getsignal(number) for number in _HANDLED}
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            for number, handler in handled.items():
                if callable(handler):
                    signal.signal(number, handler)
