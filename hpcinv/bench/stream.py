"""Bytes per second that all ranks together read and write, as ``mpirun -n 2 python -m hpcinv.bench.stream`` prints.

The sum of two vectors of STREAM (McCalpin, IEEE TCCA Newsletter, 19–25, December 1995), the best of some turns.
Products of sparse matrices and vectors can be no faster than that lets them.
"""

from __future__ import annotations

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np

from hpcinv.parallel.runtime import MPI

_LENGTH, _TURNS = 10_000_000, 10  # larger than any cache


def main() -> None:
    comm = MPI.COMM_WORLD
    a, b, c = (np.ones(_LENGTH) for _ in range(3))
    seconds = []
    for _ in range(_TURNS):
        comm.Barrier()
        begun = MPI.Wtime()
        np.add(a, b, out=c)
        seconds.append(comm.allreduce(MPI.Wtime() - begun, op=MPI.MAX))
    if comm.rank == 0:
        print(comm.size * 3 * a.nbytes / min(seconds))


if __name__ == "__main__":
    main()
