"""Execution of a batch on all ranks of one allocation, by groups of ranks that claim cases in the ledger."""

from collections.abc import Callable
from typing import cast

from hpcinv.base.parallel.ranks import MPI, agree, wait_for_all
from hpcinv.base.parallel.signals import StopRequest
from hpcinv.errors import HpcinvError, Interrupted, OutputError
from hpcinv.studies.batch.grouptask import GroupTask
from hpcinv.studies.batch.isolation import can_isolate, supervise
from hpcinv.studies.batch.ledger.liveness import LEASE
from hpcinv.studies.batch.task import Batch


def conduct(
    batch: Batch,
    world: MPI.Intracomm,
    *,
    ranks_per_case: int = 1,
    share: tuple[int, int] = (1, 1),
    lease: float = LEASE,
    isolated: bool = True,
    note: Callable[[str], None],
    stop: StopRequest | None = None,
) -> None:
    """Solve the open cases of a batch; collective.

    Args:
        share: ``(i, n)``: begin with the i-th of n parts of the cases, then continue with the other parts.
        lease: seconds within which the heartbeat of a holder on another machine must change.
        isolated: whether cases are solved in separate processes, where that is possible.
        stop: the request of a signal to stop; without it, signals are not handled and cases are not isolated.

    Raises:
        OutputError: on every rank: the number of ranks is not a multiple of ``ranks_per_case``, or the store cannot be
            used.
        Interrupted: on every rank: a signal was received, and cases are left.
    """
    if world.size % ranks_per_case:
        raise OutputError(
            f"--ranks-per-case {ranks_per_case}: {world.size} ranks cannot be divided into groups of that size",
            f"Start a multiple of {ranks_per_case} ranks.",
        )
    groups, number = world.size // ranks_per_case, world.rank // ranks_per_case
    group = cast(MPI.Intracomm, world.Split(number))
    error: HpcinvError | None = None
    try:
        part, parts = share
        begin = (part - 1 + number / groups) / parts
        if stop is not None and isolated and can_isolate(group):
            supervise(GroupTask(batch, begin, lease), group, note, stop)
        else:
            from hpcinv.studies.batch.worker import work  # with PETSc and DOLFINx

            if stop is not None:
                stop.set_end_in_library(None)  # other groups still have to save their cases
                stop.install()  # PETSc has replaced the handler of SIGTERM
            work(batch, group, begin, lease, note, stop or (lambda: False))
    except HpcinvError as met:
        error = met
        if group.rank == 0 and not isinstance(met, Interrupted):
            note(f"{met.message}; this group of ranks ends")
    wait_for_all(world)
    group.Free()
    agree(world, error)
