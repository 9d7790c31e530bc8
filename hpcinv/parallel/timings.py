"""Wall time and memory by phase, on this rank."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

from hpcinv.parallel.memory_use import Memory

WORK = ("compile", "residual", "tangent", "factorization", "linear solve", "admissibility check", "evaluation")
"""Phases that are kernels, PETSc and MPI, and the making of kernels; the rest of the wall time is overhead."""


class Timings:
    """Seconds spent in named phases; phases may nest, an inner one's time is not counted in the outer one's.

    Nor is its memory: that of a phase is what was there when it ended, or made way for an inner one.

    Attributes:
        seconds: by phase; what is done within `as_one` is all in the one phase that is named there.
        within: what was done there, by phase.
    """

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.within: defaultdict[str, float] = defaultdict(float)
        self.memory = Memory()
        self.begin = time.perf_counter()
        self._open: list[float] = []
        self._open_within: list[float] = []
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
            with _clock(phase, self.within, self._open_within):
                yield
            return
        self.memory.note(self._phases[-1])
        self._phases.append(phase)
        try:
            with _clock(phase, self.seconds, self._open):
                yield
        finally:
            self.memory.note(self._phases.pop())

    def move(self, source: str, target: str, seconds: float) -> None:
        """Count seconds that were measured elsewhere, such as by PETSc's log, in a phase of their own.

        Memory cannot be told apart like this: both have what the source has.
        """
        counted = self.within if self._absorbed else self.seconds
        counted[source] -= seconds
        counted[target] += seconds
        if seconds and not self._absorbed:
            self.memory.share(source, target)

    @property
    def total(self) -> float:
        return time.perf_counter() - self.begin


@contextmanager
def _clock(phase: str, seconds: defaultdict[str, float], opened: list[float]) -> Iterator[None]:
    """Count in a phase what passes meanwhile, but for what phases opened meanwhile count.

    Args:
        opened: for every phase that is open, what those within it have counted.
    """
    started = time.perf_counter()
    opened.append(0.0)
    try:
        yield
    finally:
        elapsed = time.perf_counter() - started
        seconds[phase] += elapsed - opened.pop()
        if opened:
            opened[-1] += elapsed
