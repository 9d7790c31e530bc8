"""Interfaces between the batch engine and its front ends (sweeps and studies): order of cases, and their solution.

A `Batch` is pickled and sent to the processes that solve its cases. There its `Schedule`, on the first rank of each
group, claims one case after the other in the ledger, and its `Runner`, on all ranks, solves them.
"""

from __future__ import annotations

import contextlib
import shutil
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self

from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.time_forecast import duration_text

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

    from hpcinv.job.job import Job
    from hpcinv.studies.batch.ledger.claims import Claim
    from hpcinv.studies.batch.ledger.ledger import Ledger


@dataclass(frozen=True)
class BatchTask:
    """A case that a group of ranks has claimed."""

    title: str
    job: Job
    claim: Claim


class Pause(Enum):
    """Result of `Schedule.next` when other groups work on all cases that are left: try again later."""

    WAIT = "wait"


class Schedule[T: BatchTask](Protocol):
    """Order in which a group takes cases; on the first rank of the group."""

    def next(self) -> T | Pause | None:
        """Claim a case; ``None`` if none is left."""

    def report(self, task: T, record: CaseRecord) -> str:
        """Return a line on the end of a case."""


class Runner[T: BatchTask](ABC):
    """Solver of cases on all ranks of a group, used as a context. All methods except `remove_run` are collective."""

    collect_every = 1
    """number of cases between garbage collections"""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()

    @abstractmethod
    def run(self, task: T, progress: Any, stop_asked: Callable[[], bool]) -> dict[str, Any]:
        """Solve a case; raises the errors of `hpcinv.driver.run`.

        Args:
            progress: a `SilentProgress`, which has the statistics of the run afterwards.
            stop_asked: called on every rank; true ends the run.

        Returns:
            The entries of the record that only the runner knows: ``start``, ``compiled``.
        """

    @abstractmethod
    def clear(self) -> None:
        """Release everything that is kept for later cases."""

    def remove_run(self, task: T, record: CaseRecord) -> None:
        """Remove the files of a committed case that are not kept; on the first rank."""
        shutil.rmtree(task.claim.run, ignore_errors=True)
        with contextlib.suppress(OSError):  # it is not empty if there were earlier rounds
            task.claim.run.parent.rmdir()


@dataclass(frozen=True)
class Batch:
    """Set of cases that any number of allocations solve together.

    Attributes:
        store: the directory that the allocations share.
        limit: largest wall time (s) of a case; ``None`` without limit.
        retry: the command that opens failed cases again.
        schedule: makes the schedule of a group from the ledger, the share (0 to 1) of the list of cases at which it
            begins, and its number of ranks.
        runner: makes the runner on the ranks of a group.
    """

    store: Path
    limit: float | None
    retry: str
    schedule: Callable[[Ledger, float, int], Schedule[Any]]
    runner: Callable[[Intracomm], Runner[Any]]

    def overdue_record(self, claim: Claim) -> CaseRecord:
        """Return the record of a case that took longer than the limit."""
        seconds = self.limit or 0.0
        advice = f"Raise 'limit' and open it again with '{self.retry}', or take larger steps or a coarser mesh."
        return CaseRecord(f"took longer than its limit of {duration_text(seconds)}", advice, {}, seconds, claim.attempt)
