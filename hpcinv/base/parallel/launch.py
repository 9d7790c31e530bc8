"""Start and end of all commands that run under mpirun: signals, ranks, and common failure."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NoReturn

from hpcinv.base.parallel.imports import paused_collection
from hpcinv.base.parallel.signals import STOPPED, StopRequest, end_on_interrupt, exit_code_of
from hpcinv.errors import Interrupted

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm


@contextmanager
def launched(ranks: int | None, *, stack: bool = True) -> Iterator[tuple[Intracomm, StopRequest]]:
    """Context with all ranks and the request to stop; an error that all ranks have is printed once.

    Args:
        stack: True if PETSc and DOLFINx are needed, False for MPI alone.
    """
    stop = StopRequest()
    stop.install()

    from hpcinv.base.parallel.ranks import MPI, abort, failing_together, require_ranks

    world = MPI.COMM_WORLD

    ending = threading.Lock()

    def end_in_library() -> NoReturn:
        if not ending.acquire(blocking=False):
            time.sleep(3600.0)  # the other thread that came here ends this process
        text = "stopped by a signal before there was anything to save"
        print(f"{text}\n  Start the same command again.", file=sys.stderr)
        abort(world, STOPPED)

    def end_if_asked() -> None:
        asked = [number for number in world.allgather(stop.signal) if number is not None]
        if signal.SIGINT in asked:
            abort(world, exit_code_of(signal.SIGINT))
        if asked:
            raise Interrupted("stopped by a signal before the run began", "Start the same command again.")

    with failing_together(world):
        end_on_interrupt(lambda: abort(world, 130))
        end_if_asked()
        if stack:
            with paused_collection():
                import hpcinv.base.parallel.runtime  # noqa: F401
        stop.install()
        stop.set_end_in_library(end_in_library)
        require_ranks(world, ranks)
        end_if_asked()
        try:
            yield world, stop
        finally:
            stop.ignore()
