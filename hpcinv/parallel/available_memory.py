"""How much memory there is for a run, whatever the batch system has set aside for it."""

from __future__ import annotations

import os
from pathlib import Path

from hpcinv.parallel.malloc import give_back_memory
from hpcinv.parallel.runtime import MPI

_MEMINFO, _CGROUP = Path("/proc/meminfo"), Path("/sys/fs/cgroup")


def available(comm: MPI.Intracomm) -> float:
    """Bytes that all ranks of ``comm`` can still take together; collective, and the same on all ranks."""
    give_back_memory()  # what is only kept counts as free
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    share = _of_this_node() / node.size
    node.Free()
    return float(comm.allreduce(share, op=MPI.SUM))


def _of_this_node() -> float:
    limits = [_free(), *_left_in_control_groups()]
    return min(limits)


def _free() -> float:
    try:
        for line in _MEMINFO.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * int(line.split()[1])
    except OSError:
        pass  # not Linux
    return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))


def _left_in_control_groups() -> list[float]:
    """What the control groups of this process, such as that of a batch job, let it take."""
    try:
        own = Path("/proc/self/cgroup").read_text().splitlines()[-1].split(":")[-1].lstrip("/")
    except (OSError, IndexError):
        return []
    found = []
    group = _CGROUP / own
    while group != _CGROUP.parent:
        try:
            limit, used = (group / "memory.max").read_text().strip(), int((group / "memory.current").read_text())
            if limit != "max":
                found.append(float(int(limit) - used))
        except (OSError, ValueError):
            pass  # the root group has no limit
        group = group.parent
    return found
