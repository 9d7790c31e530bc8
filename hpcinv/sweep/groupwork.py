"""What one group of ranks does in a sweep: it opens the store, and solves case after case."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
from hpcinv.batch.ledger.holder import Holder
from hpcinv.batch.ledger.ledger import Ledger
from hpcinv.batch.ledger.store import open_store
from hpcinv.parallel.runtime import MPI, compilation_explained, on_root
from hpcinv.sweep.queue import Queue
from hpcinv.sweep.worker import Worker

if TYPE_CHECKING:
    from hpcinv.batch.ledger.ledger import Claim
    from hpcinv.sweep.plan import Plan


def work(
    plan: Plan,
    group: MPI.Intracomm,
    begin: float,
    lease: float,
    note: Callable[[str], None],
    stop_asked: Callable[[], bool],
    holding: Callable[[Claim | None], None] | None = None,
) -> None:
    """Solve the cases that are open; its first rank alone knows the ledger. Collective.

    Args:
        begin: where in the list of all cases, from 0 to 1.
        lease: seconds in which a holder on another machine must give a sign of life.
        note: see ``Worker``.
        holding: see ``Worker``; given on the first rank where a supervisor listens.

    Raises:
        HpcinvError: the same on every rank, as ``Worker.work`` does.
    """
    with ExitStack() as held, compilation_explained(group):

        def open_queue() -> Queue:
            open_store(plan.store)
            holder = held.enter_context(Holder(plan.store))
            ledger = Ledger(plan.store, holder, lease=lease, supervised=holding is not None)
            return Queue(plan.cases, ledger, begin=begin, patience=1.2 * lease)

        queues: list[Queue] = []
        on_root(group, lambda: queues.append(open_queue()))
        queue = queues[0] if queues else None
        Worker(plan, group, queue, note, stop_asked, holding or (lambda claim: None)).work()
