"""Wall time and resident memory by phase, on this rank."""

import os
import resource
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

WORK = ("programs", "residual", "tangent", "factorization", "linear solve", "admissibility check", "evaluation")
"""Phases in kernels, PETSc and MPI, and in which programs are made; the rest of the wall time is overhead."""
NESTED = ("coarser mesh", "transfer")
"""Phases that nested iteration adds to the phases of any solve."""
SOLVER = (
    *("residual", "tangent", "factorization", "linear solve", "newton", "admissibility check", "fixed-point update"),
    *NESTED,
)
"""Phases from the first assembly to the solution."""

_UNIT = 1 if sys.platform == "darwin" else 1024
_PAGE = os.sysconf("SC_PAGE_SIZE")


class Memory:
    """Largest known resident size (bytes) of each phase.

    It is the peak of the process if the peak rose within the phase, as in the phases with the largest memory, otherwise
    the size at the end of the phase or of a part of it.
    """

    def __init__(self) -> None:
        self.phases: dict[str, int] = {}
        self._peak = peak()

    def note(self, phase: str) -> None:
        """Record the end of a phase or of a part of it."""
        highest = peak()
        size = highest if highest > self._peak else resident()
        self._peak = highest
        if size > self.phases.get(phase, 0):
            self.phases[phase] = size

    def share(self, source: str, target: str) -> None:
        """Use the size of one phase also for another, which is a part of it."""
        self.phases[target] = max(self.phases.get(source, 0), self.phases.get(target, 0))


def resident() -> int:
    """Resident memory of this process in bytes, or its peak if the system is not Linux."""
    statm = _statm(os.getpid())
    return peak() if statm is None else int(os.pread(statm, 64, 0).split()[1]) * _PAGE


def peak() -> int:
    """Largest resident memory of this process so far, in bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _UNIT


@cache
def _statm(_process: int) -> int | None:
    """Descriptor of the memory statistics of this process, kept open because it is read thousands of times."""
    try:
        return os.open("/proc/self/statm", os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None


class Timings:
    """Seconds in named phases; phases may be nested, and the time of an inner phase is not part of the outer one.

    The memory of a phase is the memory at its end, or at the beginning of an inner phase.

    Attributes:
        seconds: by phase; all time within `as_one` is in the phase named there.
        inner_seconds: time within `as_one` by phase.
    """

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.inner_seconds: defaultdict[str, float] = defaultdict(float)
        self.memory = Memory()
        self.begin = time.perf_counter()
        self._open: list[float] = []
        self._open_within: list[float] = []
        self._phases: list[str] = ["other"]
        self._absorbed = False

    @contextmanager
    def as_one(self, phase: str) -> Iterator[None]:
        """Context of a phase that includes the time of all inner phases."""
        with self(phase):
            kept_flag, self._absorbed = self._absorbed, True
            try:
                yield
            finally:
                self._absorbed = kept_flag

    @contextmanager
    def __call__(self, phase: str) -> Iterator[None]:
        """Context of a phase."""
        if self._absorbed:
            with _clock(phase, self.inner_seconds, self._open_within):
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
        """Move seconds that were measured separately, such as by the log of PETSc, from one phase to another.

        Memory cannot be separated: both phases have the memory of the source.
        """
        counted = self.inner_seconds if self._absorbed else self.seconds
        counted[source] -= seconds
        counted[target] += seconds
        if seconds and not self._absorbed:
            self.memory.share(source, target)

    @property
    def total(self) -> float:
        """Wall time (s) since the start."""
        return time.perf_counter() - self.begin


@contextmanager
def _clock(phase: str, seconds: defaultdict[str, float], opened: list[float]) -> Iterator[None]:
    """Context whose time is added to a phase, without the time of inner phases.

    Args:
        opened: time of the inner phases of each open phase.
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
