"""Arrays whose rows are distributed over the ranks, in rank order: access to rows of other ranks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hpcinv.mesh.source import Floats, Ints
from hpcinv.parallel.runtime import MPI

_CHUNK = 1 << 20


@dataclass(frozen=True)
class Rows:
    """Distribution of rows: a rank has those from ``offsets[rank]`` to ``offsets[rank + 1]``; collective."""

    comm: MPI.Intracomm
    offsets: Ints

    @classmethod
    def of(cls, comm: MPI.Intracomm, count: int) -> Rows:
        """Distribution in which this rank has ``count`` rows."""
        return cls(comm, np.concatenate([[0], np.cumsum(comm.allgather(count))]).astype(np.int64))

    @property
    def first(self) -> int:
        return int(self.offsets[self.comm.rank])

    @property
    def total(self) -> int:
        return int(self.offsets[-1])

    def fetch[T: np.generic](self, values: npt.NDArray[T], wanted: npt.NDArray[np.integer]) -> npt.NDArray[T]:
        """The rows ``wanted`` (w,), of any ranks, of an array of which this rank has the rows ``values``."""
        route = _Route.to(self.comm, self.offsets, wanted)
        return route.send_back(values[route.send(np.asarray(wanted, dtype=np.int64)[:, None])[:, 0] - self.first])

    def deliver(self, values: Floats, rows: npt.NDArray[np.integer]) -> Floats:
        """Rows of this rank of an array whose ``rows`` (w,) have ``values`` (w, c), given by any rank; else NaN."""
        route = _Route.to(self.comm, self.offsets, rows)
        mine = route.send(np.asarray(rows, dtype=np.int64)[:, None])[:, 0] - self.first
        result = np.full((int(self.offsets[self.comm.rank + 1]) - self.first, values.shape[1]), np.nan)
        result[mine] = route.send(values)
        return result

    def checksum(self, values: npt.NDArray[np.generic]) -> str:
        """Checksum (16 hex digits) of an array of which this rank has ``values``, independent of the distribution."""
        width = int(np.prod(values.shape[1:]))
        numbers = np.ascontiguousarray(values).reshape(-1).view(np.uint64)
        total = np.zeros(1, dtype=np.uint64)
        for start in range(0, len(numbers), _CHUNK):
            part = numbers[start : start + _CHUNK]
            place = np.arange(len(part), dtype=np.uint64) + np.uint64(self.first * width + start)
            total += _mixed(part ^ _mixed(place)).sum(dtype=np.uint64)
        self.comm.Allreduce(MPI.IN_PLACE, total, MPI.SUM)
        return f"{int(total[0]):016x}"


def even_range(total: int, size: int, rank: int) -> tuple[int, int]:
    """Range of the rows of one of ``size`` ranks, if all have equal numbers to within one."""
    return rank * total // size, (rank + 1) * total // size


@dataclass(frozen=True)
class _Route:
    """Exchange of rows: their order by the rank that owns them, and the numbers sent to and received from each rank."""

    comm: MPI.Intracomm
    order: Ints
    sent: Ints
    received: Ints

    @classmethod
    def to(cls, comm: MPI.Intracomm, offsets: Ints, rows: npt.NDArray[np.integer]) -> _Route:
        owner = np.searchsorted(offsets, rows, side="right") - 1  # side="right": ranks may have no rows
        sent = np.bincount(owner, minlength=comm.size).astype(np.int64)
        received = np.empty_like(sent)
        comm.Alltoall(sent, received)
        return cls(comm, np.argsort(owner, kind="stable"), sent, received)

    def send[T: np.generic](self, values: npt.NDArray[T]) -> npt.NDArray[T]:
        """Send a row of ``values`` (w, c) for each row; return those that this rank receives."""
        return self._exchanged(values[self.order], self.sent, self.received)

    def send_back[T: np.generic](self, answers: npt.NDArray[T]) -> npt.NDArray[T]:
        """Send a row of ``answers`` for each row received; return those to this rank's rows, in their order."""
        found = self._exchanged(answers, self.received, self.sent)
        result = np.empty_like(found)
        result[self.order] = found
        return result

    def _exchanged[T: np.generic](self, values: npt.NDArray[T], out: Ints, into: Ints) -> npt.NDArray[T]:
        width = values.shape[1]
        received = np.empty((int(into.sum()), width), dtype=values.dtype)
        self.comm.Alltoallv([np.ascontiguousarray(values), out * width], [received, into * width])
        return received


def _mixed(numbers: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Hash of each number to 64 bits.

    Source: Steele, Lea & Flood, "Fast splittable pseudorandom number generators" (2014), doi:10.1145/2660193.2660195.
    """
    mixed = numbers + np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return mixed ^ (mixed >> np.uint64(31))
