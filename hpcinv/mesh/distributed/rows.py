"""Arrays whose rows are spread over the ranks, in rank order: rows fetched from, and delivered to, where they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hpcinv.mesh.source import Floats, Ints
from hpcinv.parallel.runtime import MPI

_CHUNK = 1 << 20


@dataclass(frozen=True)
class Rows:
    """Which rows each rank has: those from ``offsets[rank]`` to ``offsets[rank + 1]``; all methods are collective."""

    comm: MPI.Intracomm
    offsets: Ints

    @classmethod
    def of(cls, comm: MPI.Intracomm, count: int) -> Rows:
        """Rows of which this rank has ``count``."""
        return cls(comm, np.concatenate([[0], np.cumsum(comm.allgather(count))]).astype(np.int64))

    @property
    def first(self) -> int:
        return int(self.offsets[self.comm.rank])

    @property
    def total(self) -> int:
        return int(self.offsets[-1])

    def fetch[T: np.generic](self, values: npt.NDArray[T], wanted: npt.NDArray[np.integer]) -> npt.NDArray[T]:
        """The rows ``wanted`` (w,), of any rank, of an array of which this rank has the rows ``values``."""
        route = _Route.to(self.comm, self.offsets, wanted)
        return route.back(values[route.forth(np.asarray(wanted, dtype=np.int64)[:, None])[:, 0] - self.first])

    def deliver(self, values: Floats, rows: npt.NDArray[np.integer]) -> Floats:
        """This rank's rows of an array whose ``rows`` (w,) with these ``values`` may come from anywhere; else NaN."""
        route = _Route.to(self.comm, self.offsets, rows)
        mine = route.forth(np.asarray(rows, dtype=np.int64)[:, None])[:, 0] - self.first
        result = np.full((int(self.offsets[self.comm.rank + 1]) - self.first, values.shape[1]), np.nan)
        result[mine] = route.forth(values)
        return result

    def checksum(self, values: npt.NDArray[np.generic]) -> str:
        """16 hex digits for an array of which this rank has ``values``, the same whatever rows each rank has."""
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
    """The rows of one of ``size`` ranks, where all have as many, to within one."""
    return rank * total // size, (rank + 1) * total // size


@dataclass(frozen=True)
class _Route:
    """Rows sorted by the rank that has them, how many go to each, and how many come."""

    comm: MPI.Intracomm
    order: Ints
    going: Ints
    coming: Ints

    @classmethod
    def to(cls, comm: MPI.Intracomm, offsets: Ints, rows: npt.NDArray[np.integer]) -> _Route:
        owner = np.searchsorted(offsets, rows, side="right") - 1  # of equal offsets the last: ranks may have none
        going = np.bincount(owner, minlength=comm.size).astype(np.int64)
        coming = np.empty_like(going)
        comm.Alltoall(going, coming)
        return cls(comm, np.argsort(owner, kind="stable"), going, coming)

    def forth[T: np.generic](self, values: npt.NDArray[T]) -> npt.NDArray[T]:
        """What the others send of the rows, as they come."""
        return self._exchanged(values[self.order], self.going, self.coming)

    def back[T: np.generic](self, answers: npt.NDArray[T]) -> npt.NDArray[T]:
        """The answers to what came, in the order that was asked for."""
        found = self._exchanged(answers, self.coming, self.going)
        result = np.empty_like(found)
        result[self.order] = found
        return result

    def _exchanged[T: np.generic](self, values: npt.NDArray[T], out: Ints, into: Ints) -> npt.NDArray[T]:
        width = values.shape[1]
        received = np.empty((int(into.sum()), width), dtype=values.dtype)
        self.comm.Alltoallv([np.ascontiguousarray(values), out * width], [received, into * width])
        return received


def _mixed(numbers: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Each number scattered over 64 bits.

    Source: Steele, Lea & Flood, "Fast splittable pseudorandom number generators" (2014), doi:10.1145/2660193.2660195.
    """
    mixed = numbers + np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return mixed ^ (mixed >> np.uint64(31))
