"""A sweep as a batch: its store, its queue of cases, and the runner that solves them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from hpcinv.studies.batch.task import Batch
from hpcinv.studies.sweep.results import RETRY
from hpcinv.studies.sweep.sweep_plan import SweepPlan
from hpcinv.studies.sweep.sweep_spec import Sweep

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

    from hpcinv.studies.batch.ledger.ledger import Ledger
    from hpcinv.studies.sweep.queue import Queue
    from hpcinv.studies.sweep.runner import SweepRunner


def sweep_batch(plan: SweepPlan) -> Batch:
    """Return the cases of a sweep. Queue and runner are imported where they run: supervisors must not load PETSc."""
    return Batch(plan.store, plan.sweep.limit, RETRY, partial(_queue, plan), partial(_runner, plan.sweep))


def open_damaged(plan: SweepPlan) -> int:
    """Open the cases with damaged records again, before the start of a sweep; return their number."""
    return plan.ledger.reopen_damaged(dict.fromkeys(plan.cases.keys))


def _queue(plan: SweepPlan, ledger: Ledger, begin: float, _ranks: int) -> Queue:
    from hpcinv.studies.sweep.queue import Queue

    return Queue(plan, ledger, begin=begin, patience=1.2 * ledger.lease)


def _runner(sweep: Sweep, comm: Intracomm) -> SweepRunner:
    from hpcinv.studies.sweep.runner import SweepRunner

    return SweepRunner(comm, warm_start=sweep.warm_start, keeps_solutions=sweep.keep_solutions)
