"""What is known of the runs of a study: their jobs, and the records of their executions.

Each run is executed several times, to time it. An execution is a case of the ledger: its key is the hash of the run's
content, of the number of ranks, and of its number among the repetitions.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

from hpcinv.batch.ledger.record import CaseRecord
from hpcinv.batch.status import Status, status
from hpcinv.errors import JobError
from hpcinv.job.content_key import content_key
from hpcinv.quantity.keys import look_up

if TYPE_CHECKING:
    from hpcinv.batch.ledger.ledger import Ledger
    from hpcinv.job.job import Job
    from hpcinv.study.plan import StudyPlan


RETRY = "study --retry-failed"


class Execution(NamedTuple):
    """One execution of a run as a case of the ledger; executions of one run are a reuse group."""

    key: str
    title: str
    reuse_group: str


class Executions:
    """The executions of the runs of a plan on a number of ranks, as one process knows them.

    Runs are given by their number in the plan. What is finished stays so: it is read once.
    """

    def __init__(self, plan: StudyPlan, ledger: Ledger, ranks: int) -> None:
        self.plan, self.ledger, self.ranks = plan, ledger, ranks
        self._records: dict[str, CaseRecord] = {}
        self._jobs: dict[int, tuple[Job, str] | CaseRecord] = {}
        self._by_place = {(r.place.series, r.place.step, r.place.case): i for i, r in enumerate(plan.runs)}
        self.read()

    def read(self) -> None:
        """Read the records of all executions that have been finished since the last time, by whomever."""
        asked: set[str] = set()
        while new := [key for key in self._keys() if key not in self._records and key not in asked]:
            self._records |= dict(self.ledger.records(new))  # with them further runs may be ready
            asked.update(new)

    def read_one(self, run: int, number: int) -> None:
        """Read the record of one execution of a run that is ready, if there is one."""
        key = self.execution_key(run, number)
        if key not in self._records and (record := self.ledger.record(key)) is not None:
            self._records[key] = record

    def is_ready(self, run: int) -> bool:
        """Whether all that a run takes from others is known."""
        return run in self._jobs or all(self.is_ready(i) and self._first(i) is not None for _, i in self._sources(run))

    def is_known(self, run: int, number: int) -> bool:
        """Whether there is a record of an execution of a run that is ready."""
        return self.execution_key(run, number) in self._records

    def records(self, run: int) -> list[CaseRecord]:
        """The records of a run that is ready, by the number of the execution."""
        found = self._prepared(run)
        if isinstance(found, CaseRecord):
            return [found]
        keys = (self.execution_key(run, number) for number in range(self.repetitions(run) + 1))
        return [self._records[key] for key in keys if key in self._records]

    def job(self, run: int) -> Job | None:
        """The job of a run that is ready; ``None`` if it cannot begin."""
        found = self._prepared(run)
        return None if isinstance(found, CaseRecord) else found[0]

    def key(self, run: int) -> str:
        """The hash of a run's content; runs with the same one are the same. Empty for one that cannot begin."""
        found = self._prepared(run)
        return "" if isinstance(found, CaseRecord) else found[1]

    def execution_key(self, run: int, number: int) -> str:
        """The key in the ledger of an execution, counted from 0, of a run that is ready."""
        return hashlib.sha256(f"{self.key(run)}, execution {number}".encode()).hexdigest()[:20]

    def repetitions(self, run: int) -> int:
        """How often a run is to be timed."""
        return self.plan.study.series_called(self.plan.runs[run].place.series).repeat or self.plan.study.repeat

    def needed(self, run: int) -> int:
        """How many executions a run needs in all, as far as is known: one more if one had to compile kernels.

        One that failed is not repeated.
        """
        records = self.records(run)
        if any(not record.converged for record in records):
            return 0
        return self.repetitions(run) + any(record.compiled for record in records)

    def distinct(self) -> dict[str, Execution]:
        """Return the executions that are finished or known to be needed, by key.

        Those of a run that is not ready have a provisional key; a run that cannot begin has none.
        """
        found: dict[str, Execution] = {}
        for i, run in enumerate(self.plan.runs):
            numbers = range(self.repetitions(i) + 1)
            if not self.is_ready(i):
                keys = [f"run {i}, execution {number}" for number in numbers[:-1]]
                group = ""
            elif group := self.key(i):
                keys = [self.execution_key(i, n) for n in numbers if n < self.needed(i) or self.is_known(i, n)]
            else:
                keys = []
            found |= {key: Execution(key, run.place.title, group) for key in keys if key not in found}
        return found

    def count(self) -> tuple[int, int]:
        """Number of executions that are finished, and of all that are known to be needed."""
        executions = self.distinct()
        return len(executions.keys() & self._records.keys()), len(executions)

    def status(self) -> Status:
        """Return the status of the study; reads what was finished or opened again since the last time."""
        self._records = {key: record for key, record in self._records.items() if record.converged}
        self._jobs = {run: found for run, found in self._jobs.items() if not isinstance(found, CaseRecord)}
        self.read()
        executions = self.distinct()
        records = {key: self._records[key] for key in executions if key in self._records}
        cases = list(executions.values())
        return status(self.plan.study.study, cases, self.ledger, records, retry=RETRY, kind="executions")

    def retry(self) -> int:
        """Open the executions that failed again; tells how many."""
        failed = [key for key, record in self._records.items() if not record.converged]
        opened = [key for key in failed if self.ledger.retry(key)]
        self._records = {key: record for key, record in self._records.items() if key not in opened}
        return len(opened)

    def _keys(self) -> dict[str, None]:
        ready = (i for i in range(len(self.plan.runs)) if self.is_ready(i) and self.key(i))
        return dict.fromkeys(self.execution_key(i, n) for i in ready for n in range(self.repetitions(i) + 1))

    def _first(self, run: int) -> CaseRecord | None:
        """The record of the first execution of a run that is ready, or why it cannot begin."""
        found = self._prepared(run)
        return found if isinstance(found, CaseRecord) else self._records.get(self.execution_key(run, 0))

    def _sources(self, run: int) -> Iterator[tuple[str, int]]:
        """Keys that take their value from another run, with its number."""
        place = self.plan.runs[run].place
        for key, taken in self.plan.study.series_called(place.series).take.items():
            step = place.step if self.plan.study.series_called(taken.series).steps > 1 else 0
            yield key, self._by_place[taken.series, step, place.case]

    def _prepared(self, run: int) -> tuple[Job, str] | CaseRecord:
        """The job of a run and its hash, or why there is none: another run, from which it takes values, has failed."""
        if run not in self._jobs:
            job = self._completed(run)
            if not isinstance(job, CaseRecord):
                # All that the result and the time of a run depend on.
                self._jobs[run] = job, content_key(job, ranks=self.ranks, partition=job.mesh.partition)
            else:
                self._jobs[run] = job
        return self._jobs[run]

    def _completed(self, number: int) -> Job | CaseRecord:
        run, values = self.plan.runs[number], {}
        for key, source in self._sources(number):
            taken, record = self.plan.study.series_called(run.place.series).take[key], self._first(source)
            if record is None:
                raise ValueError(f"run {number} is not ready")
            value = look_up(record.statistics, taken.key) if record.converged else None
            if value is None:
                why = "has failed" if not record.converged else f"has no number at {taken.key}"
                return _not_run(f"'{taken.series}', which {key} is taken from, {why}")
            values[key] = max(value, taken.at_least)
        try:
            return run.with_values(values) if values else run.job
        except JobError as error:
            return _not_run("; ".join(error.problems))


def _not_run(why: str) -> CaseRecord:
    return CaseRecord(f"not run: {why}", "", {}, 0.0, 0)
