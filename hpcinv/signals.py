"""Signals that ask a run to stop: they only set a flag, which all ranks agree on at the next iteration.

Imported before MPI starts, since some launchers keep handlers that are installed later from being called.
"""

from __future__ import annotations

import signal
from types import FrameType


class StopRequest:
    """Whether SIGTERM or SIGUSR1 has arrived on this rank."""

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None

    def install(self) -> None:
        """Handle the signals of this process from now on."""
        for number in (signal.SIGTERM, signal.SIGUSR1):
            signal.signal(number, self._note)

    def __call__(self) -> bool:
        return self.signal is not None

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.signal = signal.Signals(number)
