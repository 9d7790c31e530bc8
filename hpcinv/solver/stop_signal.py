"""A request to stop, such as a signal, that ends the solves of a run."""

from __future__ import annotations

from collections.abc import Callable

from hpcinv.solver.observer import Observer


class StopSignal(Observer):
    """Asks to stop when a function says so, such as one that knows of signals."""

    def __init__(self, asked: Callable[[], bool]) -> None:
        self.asked = asked

    def stop_asked(self) -> bool:
        return self.asked()
