"""How many unknowns the memory of a machine allows, judged by what a run has taken so far."""

from __future__ import annotations

from hpcinv.parallel.available_memory import available
from hpcinv.parallel.memory_use import peak
from hpcinv.parallel.runtime import MPI

USABLE = 0.7  # share of the memory that is there when the first mesh is made
# Factors of a three-dimensional problem fill as N^(4/3): George (1973), doi:10.1137/0710032.
FILL = 4 / 3
LEAST = 50e6  # bytes: what is taken below tells nothing


class RefinementMemory:
    """Of all ranks; collective."""

    def __init__(self, comm: MPI.Intracomm) -> None:
        self.comm = comm
        self.free = USABLE * available(comm) / comm.size
        self.before = peak()

    def limit(self, unknowns: int) -> int:
        """Most unknowns that leave room, after so many (of an estimate, or of a solve) have been the most so far."""
        taken = max(peak() - self.before, LEAST)
        ratio = self.comm.allreduce(self.free / taken, op=MPI.MIN)
        return int(unknowns * ratio ** (1 / FILL))
