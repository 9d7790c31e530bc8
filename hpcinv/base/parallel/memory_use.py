"""Resident memory of this process, by phase of a run."""

import os
import resource
import sys
from functools import cache

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
