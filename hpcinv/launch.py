"""What every command that runs under mpirun begins and ends with: signals, ranks, and failing together."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from hpcinv.signals import StopRequest, end_on_interrupt

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm


@contextmanager
def launched(ranks: int | None) -> Iterator[tuple[Intracomm, StopRequest]]:
    """All ranks, and whether a signal has asked them to stop; an error that all of them share is told once.

    Args:
        ranks: number of ranks that there must be, ``None`` for any.
    """
    stop = StopRequest()
    stop.install()

    from hpcinv.runtime import MPI, abort, failing_together, require_ranks

    stop.install()
    world = MPI.COMM_WORLD
    with failing_together(world):
        end_on_interrupt(lambda: abort(world, 130))
        require_ranks(world, ranks)
        try:
            yield world, stop
        finally:
            stop.ignore()
