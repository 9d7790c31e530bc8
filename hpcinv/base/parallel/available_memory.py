"""Memory that is available to a run, within the limits of the batch system."""

import os
from pathlib import Path

from hpcinv.base.parallel.malloc import release_freed_memory
from hpcinv.base.parallel.runtime import MPI

_MEMINFO, _CGROUP = Path("/proc/meminfo"), Path("/sys/fs/cgroup")


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
