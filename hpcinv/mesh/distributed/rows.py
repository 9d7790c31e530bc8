"""Arrays whose rows are distributed over the ranks, in rank order: access to rows of other ranks."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from mpi4py.util.dtlib import from_numpy_dtype
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.source import Floats, Ints

_CHUNK = 1 << 20


@dataclass(frozen=True)
class Rows:
    """Distribution of rows: a rank has those from ``offsets[rank]`` to ``offsets[rank + 1]``; collective."""

    comm: MPI.Intracomm
    offsets: Ints

    @classmethod
    def distributed(cls, comm: MPI.Intracomm, count: int) -> Self:
        """Distribution in which this rank has ``count`` rows."""
        return cls(comm, np.concatenate([[0], np.cumsum(comm.allgather(count))]).astype(np.int64))

    @property
    def first(self) -> int:
        return int(self.offsets[self.comm.rank])

    @property
    def total(self) -> int:
        return int(self.offsets[-1])

    def fetch[T: np.generic](self, values: npt.NDArray[T], wanted: npt.NDArray[np.integer]) -> npt.NDArray[T]:
        """The rows ``wanted`` (w,), of any ranks, of an array; this rank has its rows ``values`` (n, c)."""
        mine, fetched = np.ascontiguousarray(values), np.empty((len(wanted), values.shape[1]), dtype=values.dtype)
        with self._forest(len(mine), wanted, mine) as (forest, row):
            forest.bcastBegin(row, mine, fetched, MPI.REPLACE)
            forest.bcastEnd(row, mine, fetched, MPI.REPLACE)
        return fetched

    def deliver(self, values: Floats, rows: npt.NDArray[np.integer]) -> Floats:
        """Rows of this rank of an array whose ``rows`` (w,) have ``values`` (w, c), given by any rank; else NaN."""
        given, count = np.ascontiguousarray(values), int(self.offsets[self.comm.rank + 1]) - self.first
        result = np.full((count, values.shape[1]), np.nan)
        with self._forest(count, rows, given) as (forest, row):
            forest.reduceBegin(row, given, result, MPI.REPLACE)
            forest.reduceEnd(row, given, result, MPI.REPLACE)
        return result

    @contextmanager
    def _forest(self, count: int, rows: npt.NDArray[np.integer], values: npt.NDArray[Any]) -> Iterator[tuple[Any, Any]]:
        """Context with PETSc's star forest from ``rows`` (w,) to the ``count`` ones of each rank, and a row's type."""
        owner = np.searchsorted(self.offsets, rows, side="right") - 1  # side="right": ranks may have no rows
        forest: Any = PETSc.SF()  # whose type hints take no arrays
        forest.create(self.comm)
        place = np.stack([owner, rows - self.offsets[owner]], axis=1).astype(PETSc.IntType)
        forest.setGraph(count, None, place)
        row = from_numpy_dtype(values.dtype).Create_contiguous(values.shape[1]).Commit()
        try:
            yield forest, row
        finally:
            row.Free()
            forest.destroy()

    def checksum(self, values: npt.NDArray[np.generic]) -> str:
        """Checksum (16 hex digits) of an array, from each rank's ``values``; any distribution has the same."""
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


def _mixed(numbers: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Hash of each number to 64 bits.

    Source: Steele, Lea & Flood, "Fast splittable pseudorandom number generators" (2014), doi:10.1145/2660193.2660195.
    """
    mixed = numbers + np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return mixed ^ (mixed >> np.uint64(31))
