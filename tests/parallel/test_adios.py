"""ADIOS2's bindings without MPI, with the libraries with MPI of DOLFINx."""

from pathlib import Path

import pytest
from mpi4py import MPI

from hpcinv.base.parallel.adios import adios2

# isort: split
import numpy as np

MANY = 3000
"""more objects than MPICH has communicators: 2048"""


@pytest.mark.parallel(2)
def test_ranks_write_one_file_and_each_reads_all(tmp_path: Path) -> None:
    comm = MPI.COMM_WORLD
    path = comm.bcast(tmp_path / "rows.bp")
    rows, length = np.arange(3.0) + 10 * comm.rank, 3 * comm.size

    def stream(mode: str) -> adios2.Stream:
        io = adios2.Adios(comm=comm).declare_io("rows")
        io.set_engine("BP4")
        return adios2.Stream(io, str(path), mode)

    with stream("w") as written:
        written.begin_step()
        written.write("rows", rows, [length], [3 * comm.rank], [3])
        written.end_step()
    with stream("rra") as read:
        assert list(read.read("rows", [0], [length])) == [0, 1, 2, 10, 11, 12]


def test_objects_free_their_communicators_and_memory() -> None:
    def memory() -> int:  # pages
        return int(Path("/proc/self/statm").read_text().split()[1])

    for _ in range(MANY):
        adios2.bindings.ADIOS(MPI.COMM_SELF)
    before = memory()
    for _ in range(MANY):
        adios2.bindings.ADIOS(MPI.COMM_SELF)
    assert memory() - before < 50


def test_the_process_has_one_adios2() -> None:
    maps = Path("/proc/self/maps").read_text().splitlines()
    assert len({line.split()[-1] for line in maps if "libadios2_core.so" in line}) == 1
