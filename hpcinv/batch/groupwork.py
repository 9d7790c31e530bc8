"""What one group of ranks does: it opens the store, and solves case after case."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
from hpcinv.batch.ledger.holder import Holder
from hpcinv.batch.ledger.ledger import Ledger
from hpcinv.batch.ledger.store import open_store
from hpcinv.batch.worker import Worker
from hpcinv.parallel.runtime import MPI, compilation_explained, on_root

if TYPE_CHECKING:
    from hpcinv.batch.task import Batch, BatchTask


def work(
    batch: Batch,
    group: MPI.Intracomm,
    begin: float,
    lease: float,
    note: Callable[[str], None],
    stop_asked: Callable[[], bool],
    holding: Callable[[BatchTask | None], None] | None = None,
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

        def open_ledger() -> Ledger:
            open_store(batch.store)
            holder = held.enter_context(Holder(batch.store))
            return Ledger(batch.store, holder, lease=lease, supervised=holding is not None)

        ledgers: list[Ledger] = []
        on_root(group, lambda: ledgers.append(open_ledger()))
        ledger = ledgers[0] if ledgers else None
        Worker(batch, group, ledger, begin, note, stop_asked, holding or (lambda task: None)).work()
