"""What a front end hands to the engine: in which order cases are solved, and how.

A `Batch` is sent to the processes that solve its cases, by pickle. There its `Schedule`, on the first rank of each
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

from hpcinv.batch.forecast import in_words
from hpcinv.batch.ledger.record import CaseRecord

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

    from hpcinv.batch.ledger.ledger import Claim, Ledger
    from hpcinv.job.job import Job


@dataclass(frozen=True)
class BatchTask:
    """A case that a group of ranks has claimed."""

    title: str
    job: Job
    claim: Claim


class Pause(Enum):
    """That nothing can be claimed at the moment, but perhaps later: others work on what is left."""

    WAIT = "wait"


class Schedule[T: BatchTask](Protocol):
    """Which case a group takes next; it lives on the first rank of the group."""

    def next(self) -> T | Pause | None:
        """Claim a case; ``None`` when nothing is left to be done."""

    def report(self, task: T, record: CaseRecord) -> str:
        """A line on how a case ended."""


class Runner[T: BatchTask](ABC):
    """How cases are solved, on all ranks of a group; use it as a context. All methods but `tidy` are collective."""

    collect_every = 1
    """cases between collections of garbage"""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()

    @abstractmethod
    def run(self, task: T, heard: Any, stop_asked: Callable[[], bool]) -> dict[str, Any]:
        """Solve a case, as `hpcinv.driver.run` does, and with its errors.

        Args:
            heard: the run's progress, which has its statistics afterwards.
            stop_asked: asked on every rank.

        Returns:
            Entries of the record, of those that only the runner knows: ``start``, ``compiled``.
        """

    @abstractmethod
    def clear(self) -> None:
        """Drop all that is kept for the cases to come."""

    def tidy(self, task: T, record: CaseRecord) -> None:
        """Remove what is not to be kept of a case that is committed; on the first rank."""
        shutil.rmtree(task.claim.run, ignore_errors=True)
        with contextlib.suppress(OSError):  # there may be those of earlier rounds
            task.claim.run.parent.rmdir()


class Batch(ABC):
    """Cases that any number of allocations solve together.

    Attributes:
        retry: the command that opens failed cases again.
    """

    retry: str

    @property
    @abstractmethod
    def store(self) -> Path:
        """The directory that the allocations share."""

    @property
    @abstractmethod
    def limit(self) -> float | None:
        """Wall time (s) that a case may take; ``None``: any."""

    @abstractmethod
    def schedule(self, ledger: Ledger, begin: float, ranks: int) -> Schedule[Any]:
        """The schedule of a group of so many ranks; ``begin``: where in the list of all cases, from 0 to 1."""

    @abstractmethod
    def runner(self, comm: Intracomm) -> Runner[Any]:
        """What solves cases on the ranks of a group."""

    def overdue_record(self, claim: Claim) -> CaseRecord:
        """The record of a case that took longer than the limit."""
        seconds = self.limit or 0.0
        advice = f"Raise 'limit' and open it again with '{self.retry}', or take larger steps or a coarser mesh."
        return CaseRecord(f"took longer than its limit of {in_words(seconds)}", advice, {}, seconds, claim.attempt)
