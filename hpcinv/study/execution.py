"""A study as a batch: what the engine executes, in which order, and how."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
from hpcinv.batch.task import Batch
from hpcinv.study.directory import store_in
from hpcinv.study.executions import Executions
from hpcinv.study.plan import StudyPlan
from hpcinv.study.runner import StudyRunner
from hpcinv.study.schedule import StudySchedule

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

    from hpcinv.batch.ledger.ledger import Ledger


@dataclass(frozen=True)
class StudyBatch(Batch):
    """The executions of the runs of a study in a directory."""

    plan: StudyPlan
    directory: Path
    retry = "study --retry-failed"

    @property
    def store(self) -> Path:
        return store_in(self.directory)

    @property
    def limit(self) -> float | None:
        return self.plan.study.limit

    def schedule(self, ledger: Ledger, begin: float, ranks: int) -> StudySchedule:
        return StudySchedule(Executions(self.plan, ledger, ranks))

    def runner(self, comm: Intracomm) -> StudyRunner:
        return StudyRunner(comm)
