"""A sweep as a batch: its store, its queue of cases, and the runner that solves them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hpcinv.batch.task import Batch
from hpcinv.sweep.plan import SweepPlan
from hpcinv.sweep.results import RETRY

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

    from hpcinv.batch.ledger.ledger import Ledger
    from hpcinv.sweep.queue import Queue
    from hpcinv.sweep.runner import SweepRunner


@dataclass(frozen=True)
class SweepBatch(Batch):
    """The cases of a sweep. Queue and runner are imported where they run, since supervisors must not load PETSc."""

    plan: SweepPlan
    retry = RETRY

    @property
    def store(self) -> Path:
        return self.plan.store

    @property
    def limit(self) -> float | None:
        return self.plan.sweep.limit

    def schedule(self, ledger: Ledger, begin: float, ranks: int) -> Queue:
        from hpcinv.sweep.queue import Queue

        return Queue(self.plan, ledger, begin=begin, patience=1.2 * ledger.lease)

    def runner(self, comm: Intracomm) -> SweepRunner:
        from hpcinv.sweep.runner import SweepRunner

        return SweepRunner(comm, warm_start=self.plan.sweep.warm_start)
