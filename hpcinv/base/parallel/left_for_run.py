"""What is left to a run: memory within the limits of the batch system, and communicators of MPI."""

import gc
import os
from contextlib import suppress
from pathlib import Path

from hpcinv.base.parallel.malloc import release_freed_memory
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import OutOfMemory

_MEMINFO, _CGROUP = Path("/proc/meminfo"), Path("/sys/fs/cgroup")

_OF_A_RUN = 128
"""Communicators that must be left, of 2,048 with MPICH, without one of which DOLFINx crashes: ten times what a result
keeps. Raised, fewer results fit into a process; lowered, runs that take more crash."""


def available(comm: MPI.Intracomm) -> float:
    """Bytes that all ranks of ``comm`` together can still allocate; collective, the same on all ranks."""
    release_freed_memory()  # memory that malloc keeps counts as free
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    share = min([_free(), *_left_in_control_groups()]) / node.size
    node.Free()
    return float(comm.allreduce(share, op=MPI.SUM))


def _free() -> float:
    """Free memory of this node in bytes, or all memory if the system is not Linux."""
    try:
        for line in _MEMINFO.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * int(line.split()[1])
    except OSError:
        pass
    return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))


def _left_in_control_groups() -> list[float]:
    """Bytes left in each control group of this process with a limit, such as the group of a batch job."""
    try:
        own = Path("/proc/self/cgroup").read_text().splitlines()[-1].split(":")[-1].lstrip("/")
    except (OSError, IndexError):
        return []
    left_bytes = []
    group = _CGROUP / own
    while group != _CGROUP.parent:
        try:
            limit, used = (group / "memory.max").read_text().strip(), int((group / "memory.current").read_text())
            if limit != "max":
                left_bytes.append(float(int(limit) - used))
        except (OSError, ValueError):
            pass  # the root group has no limit
        group = group.parent
    return left_bytes


def require_communicators(comm: MPI.Intracomm) -> None:
    """Collect garbage, which holds communicators, if few of them are left; collective.

    Raises:
        OutOfMemory: on all ranks, if too few are left after that.
    """
    if _are_few(comm):
        gc.collect()
        if _are_few(comm):
            raise OutOfMemory(
                "this process keeps so many results that MPI has no communicators left for another run",
                "Keep arrays and numbers of results instead of the results, whose bodies hold communicators.",
            )


def _are_few(comm: MPI.Intracomm) -> bool:
    """Return whether one of the ranks has fewer communicators left than a run may take; collective."""
    made = list[MPI.Intracomm]()
    with suppress(MPI.Exception):
        made.extend(MPI.COMM_SELF.Dup() for _ in range(_OF_A_RUN))
    is_few = len(made) < _OF_A_RUN
    for own in made:
        own.Free()
    return bool(comm.allreduce(is_few, op=MPI.LOR))
