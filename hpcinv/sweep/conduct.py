"""A sweep on all ranks of one allocation: groups of ranks that take cases from the ledger, and how it ended."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
from hpcinv.errors import HpcinvError, Interrupted, OutputError
from hpcinv.runtime import MPI, agree, compilation_explained, on_root
from hpcinv.sweep.holder import Holder
from hpcinv.sweep.ledger import Ledger
from hpcinv.sweep.queue import Queue
from hpcinv.sweep.store import open_store
from hpcinv.sweep.worker import Worker

if TYPE_CHECKING:
    from hpcinv.sweep.plan import Plan


@dataclass(frozen=True)
class Share:
    """The part of the cases, counted from 1, with which an allocation begins before it helps others with theirs."""

    number: int = 1
    of: int = 1

    def begin(self, group: int, groups: int) -> float:
        """Where one of its groups begins in the list of all cases, from 0 to 1."""
        return (self.number - 1 + group / groups) / self.of


def conduct(
    plan: Plan,
    world: MPI.Intracomm,
    *,
    ranks_per_case: int = 1,
    share: Share = Share(),
    lease: float,
    note: Callable[[str], None],
    stop_asked: Callable[[], bool],
) -> None:
    """Run the cases of a sweep that are open; collective.

    Args:
        lease: seconds in which a holder on another machine must give a sign of life.
        note: called on the first rank of each group.

    Raises:
        OutputError: on every rank: the number of ranks does not suit, or the store cannot be used.
        Interrupted: on every rank: a signal came, and cases are left.
    """
    groups = _groups(world, ranks_per_case)
    number = world.rank // ranks_per_case
    group = cast(MPI.Intracomm, world.Split(number))
    error: HpcinvError | None = None
    try:
        with compilation_explained(group):
            _work(plan, group, share.begin(number, groups), lease, note, stop_asked)
    except HpcinvError as met:
        error = met
        if group.rank == 0 and not isinstance(met, Interrupted):
            note(f"{met.message}; this group of ranks ends")
    _wait_for_all(world)
    group.Free()
    agree(world, error)


def _groups(world: MPI.Intracomm, ranks_per_case: int) -> int:
    if world.size % ranks_per_case:
        raise OutputError(
            f"--ranks-per-case {ranks_per_case}: {world.size} ranks cannot be divided into groups of that size",
            f"Start a multiple of {ranks_per_case} ranks.",
        )
    return world.size // ranks_per_case


def _work(
    plan: Plan,
    group: MPI.Intracomm,
    begin: float,
    lease: float,
    note: Callable[[str], None],
    stop_asked: Callable[[], bool],
) -> None:
    """What one group does; its first rank alone knows the ledger."""
    with ExitStack() as held:

        def open_queue() -> Queue:
            open_store(plan.store)
            holder = held.enter_context(Holder(plan.store))
            return Queue(plan.cases, Ledger(plan.store, holder, lease=lease), begin=begin, patience=1.2 * lease)

        queues: list[Queue] = []
        on_root(group, lambda: queues.append(open_queue()))
        Worker(plan, group, queues[0] if queues else None, note, stop_asked).work()


def _wait_for_all(world: MPI.Intracomm) -> None:
    """A barrier that leaves the cores to those who still work."""
    everyone = world.Ibarrier()
    while not everyone.Test():
        time.sleep(0.02)
