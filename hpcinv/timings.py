"""Wall time and memory by phase, on this rank."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

from hpcinv.memory import Memory


class Timings:
    """Seconds spent in named phases; phases may nest, an inner one's time is not counted in the outer one's.

    Nor is its memory: that of a phase is what was there when it ended, or made way for an inner one.

    Within `as_one` all is counted in the one phase that is named there.
    """

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.memory = Memory()
        self.begin = time.perf_counter()
        self._stack: list[list[float]] = []
        self._phases: list[str] = ["other"]
        self._absorbed = False

    @contextmanager
    def as_one(self, phase: str) -> Iterator[None]:
        """A phase with all that is in it."""
        with self(phase):
            before, self._absorbed = self._absorbed, True
            try:
                yield
            finally:
                self._absorbed = before

    @contextmanager
    def __call__(self, phase: str) -> Iterator[None]:
        if self._absorbed:
            yield
            return
        self.memory.note(self._phases[-1])
        started, inner = time.perf_counter(), [0.0]
        self._stack.append(inner)
        self._phases.append(phase)
        try:
            yield
        finally:
            elapsed = time.perf_counter() - started
            self._stack.pop()
            self.memory.note(self._phases.pop())
            self.seconds[phase] += elapsed - inner[0]
            if self._stack:
                self._stack[-1][0] += elapsed

    def move(self, source: str, target: str, seconds: float) -> None:
        """Count seconds that were measured elsewhere, such as by PETSc's log, in a phase of their own.

        Memory cannot be told apart like this: both have what the source has.
        """
        if self._absorbed:
            return
        self.seconds[source] -= seconds
        self.seconds[target] += seconds
        if seconds:
            self.memory.share(source, target)

    @property
    def total(self) -> float:
        return time.perf_counter() - self.begin
