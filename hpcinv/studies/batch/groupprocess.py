"""Program of the processes that solve the cases of one group, separate from those that the launcher has started.

``python -m hpcinv.studies.batch.groupprocess DIRECTORY``, on one rank, or under mpiexec on several. They write to a
file in the directory which case they solve; the supervisor that has started them (`isolation`) reads it, also after a
crash.
"""

from hpcinv.base.parallel.signals import StopRequest

stop = StopRequest()
stop.install()  # before anything that takes time

import sys  # noqa: E402
from pathlib import Path  # noqa: E402

from hpcinv.base.parallel.imports import imports_explained  # noqa: E402
from hpcinv.base.parallel.signals import STOPPED, end_on_interrupt  # noqa: E402
from hpcinv.errors import HpcinvError  # noqa: E402


def main(directory: Path) -> int:
    """Solve cases until none is left, and report the end; the exit code is 0 unless the processes ended otherwise."""
    from hpcinv.base.parallel.ranks import MPI, abort, failing_together, on_root, wait_for_all
    from hpcinv.studies.batch.grouptask import EventWriter, GroupTask

    stop.install()
    world = MPI.COMM_WORLD
    end_on_interrupt(lambda: abort(world, 130))
    stop.set_end_in_library(lambda: abort(world, STOPPED))  # the supervisor releases the case
    with failing_together(world):
        events = EventWriter(directory) if world.rank == 0 else None
        task = on_root(world, lambda: GroupTask.read(directory))
        error: HpcinvError | None = None
        try:
            holding = events.holding if events is not None else None
            with imports_explained():
                from hpcinv.studies.batch.worker import work  # with PETSc and DOLFINx
            stop.install()
            work(task.batch, world, task.begin, task.lease, lambda text: print(text, flush=True), stop, holding)
        except HpcinvError as met:
            error = met
        stop.ignore()
        if events is not None:
            events.ended(error)
        if not wait_for_all(world, patience=5.0):
            abort(world, 1)
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
