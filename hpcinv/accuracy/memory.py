"""How many unknowns the memory of a machine allows, judged by what a run has taken so far."""

from __future__ import annotations

import os

from hpcinv.memory import peak
from hpcinv.runtime import MPI

USABLE = 0.7  # share of the machine's memory
# Factors of a three-dimensional problem fill as N^(4/3): George (1973), doi:10.1137/0710032.
FILL = 4 / 3
LEAST = 50e6  # bytes: what is taken below tells nothing


class Memory:
    """Of all ranks; collective."""

    def __init__(self, comm: MPI.Intracomm) -> None:
        machine = comm.Split_type(MPI.COMM_TYPE_SHARED)
        self.comm = comm
        self.share = USABLE * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / machine.size
        machine.Free()
        self.before = peak()

    def limit(self, unknowns: int) -> int:
        """Most unknowns that leave room, after so many (of an estimate, or of a solve) have been the most so far."""
        taken, free = max(peak() - self.before, LEAST), max(self.share - self.before, 0.0)
        ratio = self.comm.allreduce(free / taken, op=MPI.MIN)
        return int(unknowns * ratio ** (1 / FILL))
