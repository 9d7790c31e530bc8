"""Runs of a study: their jobs, and the records of their executions.

Each run is executed several times, to time it. An execution is a case of the ledger: its key is the hash of the run's
content, of the number of ranks, and of its number among the repetitions.
"""

import hashlib
from collections.abc import Iterator
from pathlib import Path

from hpcinv.base.quantity.keys import look_up
from hpcinv.errors import JobError
from hpcinv.job.fingerprint import content_key
from hpcinv.job.job import Job
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.ledger import Ledger, ledger_of
from hpcinv.studies.batch.outcomes import outcomes_of
from hpcinv.studies.batch.status import BatchCase, Status, status
from hpcinv.studies.study.directory import STORE, check_content, ranks_in
from hpcinv.studies.study.study_plan import StudyPlan

RETRY = "study --retry-failed"


class Executions:
    """Executions of the runs of a plan on a number of ranks, as one process has read them.

    Runs are given by their number in the plan. The record of a finished execution is read once.
    """

    def __init__(self, plan: StudyPlan, ledger: Ledger, ranks: int) -> None:
        self.plan, self.ledger, self.ranks = plan, ledger, ranks
        self._records: dict[str, CaseRecord] = {}
        self._homes: dict[str, Path] = {}
        ledger.home_of = self._homes.get
        self._jobs: dict[int, tuple[Job, str] | CaseRecord] = {}
        self._run_numbers = {(r.place.series, r.place.step, r.place.case): i for i, r in enumerate(plan.runs)}
        self.read()

    def read(self) -> None:
        """Read the records of all executions that any process has finished since the last call."""
        requested: set[str] = set()
        self._register_homes()
        while new := [key for key in self._keys() if key not in self._records and key not in requested]:
            self._records |= dict(self.ledger.records(new))  # with these records further runs may be ready
            requested.update(new)
            self._register_homes()

    def is_ready(self, run: int) -> bool:
        """Return whether all values that a run takes from other runs are known."""
        return run in self._jobs or all(self.is_ready(i) and self._first(i) is not None for _, i in self._sources(run))

    def records(self, run: int) -> list[CaseRecord]:
        """Return the records of a ready run, in the order of its executions."""
        prepared = self._prepared(run)
        if isinstance(prepared, CaseRecord):
            return [prepared]
        keys = (self.execution_key(run, number) for number in range(self.repetitions(run) + 1))
        return [self._records[key] for key in keys if key in self._records]

    def key(self, run: int) -> str:
        """Return the hash of a ready run's content, the same for equal runs; empty if the run cannot begin."""
        prepared = self._prepared(run)
        return "" if isinstance(prepared, CaseRecord) else prepared[1]

    def execution_key(self, run: int, number: int) -> str:
        """Return the key in the ledger of an execution (from 0) of a ready run."""
        return hashlib.sha256(f"{self.key(run)}, execution {number}".encode()).hexdigest()[:20]

    def repetitions(self, run: int) -> int:
        return self.plan.study.series_called(self.plan.runs[run].place.series).repeat or self.plan.study.repeat

    def needed(self, run: int) -> int:
        """Return the number of executions that a run needs, as far as is known: one more if one made programs.

        It is 0 after a failure, which is not repeated.
        """
        records = self.records(run)
        if any(not record.converged for record in records):
            return 0
        return self.repetitions(run) + any(record.compiled for record in records)

    def distinct(self) -> dict[str, BatchCase]:
        """Return the executions that are finished or known to be needed, by key; one run's are a reuse group.

        Executions of a run that is not ready have a provisional key; a run that cannot begin has none.
        """
        cases: dict[str, BatchCase] = {}
        for i, run in enumerate(self.plan.runs):
            numbers = range(self.repetitions(i) + 1)
            if not self.is_ready(i):
                keys = [f"run {i}, execution {number}" for number in numbers[:-1]]
                group = ""
            elif group := self.key(i):
                needed, possible = self.needed(i), [self.execution_key(i, n) for n in numbers]
                keys = [key for n, key in enumerate(possible) if n < needed or key in self._records]
            else:
                keys = []
            cases |= {key: BatchCase(key, run.place.title, group) for key in keys if key not in cases}
        return cases

    def open_ones(self) -> list[tuple[int, int, Job]]:
        """Return number, run and job of the executions that can begin, in this order.

        Further executions of a run begin when the first one has converged.
        """
        open_executions = []
        for i in range(len(self.plan.runs)):
            if self.is_ready(i) and not isinstance(prepared := self._prepared(i), CaseRecord):
                left = [n for n in range(self.needed(i)) if self.execution_key(i, n) not in self._records]
                open_executions += [(n, i, prepared[0]) for n in (left[:1] if 0 in left else left)]
        return sorted(open_executions, key=lambda entry: entry[:2])

    def count(self) -> tuple[int, int]:
        """Return the numbers of executions that are finished, and that are finished or needed."""
        executions = self.distinct()
        return len(executions.keys() & self._records.keys()), len(executions)

    def status(self) -> Status:
        """Return the status of the study; reads what was finished or opened again since the last time."""
        self._records = {key: record for key, record in self._records.items() if record.converged}
        self._jobs = {run: prepared for run, prepared in self._jobs.items() if not isinstance(prepared, CaseRecord)}
        self.read()
        executions = self.distinct()
        outcomes = outcomes_of((key, self._records[key]) for key in executions if key in self._records)
        cases = list(executions.values())
        return status(self.plan.study.study, cases, self.ledger, outcomes, retry=RETRY, kind="executions")

    def retry(self) -> int:
        """Open the failed executions again; return their number."""
        failed = [key for key, record in self._records.items() if not record.converged]
        opened = self.ledger.retry(*failed)
        self._records = {key: record for key, record in self._records.items() if key not in opened}
        return len(opened)

    def _register_homes(self) -> None:
        """Let the ledger know where the generators of the meshes of the ready runs are."""
        for run in range(len(self.plan.runs)):
            if self.is_ready(run) and not isinstance(prepared := self._prepared(run), CaseRecord):
                home = prepared[0].resolve(prepared[0].mesh.file).absolute().parent
                self._homes |= {self.execution_key(run, n): home for n in range(self.repetitions(run) + 1)}

    def _keys(self) -> dict[str, None]:
        ready = (i for i in range(len(self.plan.runs)) if self.is_ready(i) and self.key(i))
        return dict.fromkeys(self.execution_key(i, n) for i in ready for n in range(self.repetitions(i) + 1))

    def _first(self, run: int) -> CaseRecord | None:
        """Return the record of the first execution of a ready run, or the reason why the run cannot begin."""
        prepared = self._prepared(run)
        return prepared if isinstance(prepared, CaseRecord) else self._records.get(self.execution_key(run, 0))

    def _sources(self, run: int) -> Iterator[tuple[str, int]]:
        """Yield the keys that take their value from another run, with its number."""
        place = self.plan.runs[run].place
        for key, taken in self.plan.study.series_called(place.series).take.items():
            step = place.step if self.plan.study.series_called(taken.series).steps > 1 else 0
            yield key, self._run_numbers[taken.series, step, place.case]

    def _prepared(self, run: int) -> tuple[Job, str] | CaseRecord:
        """Return job and hash of a ready run, or the reason why there is none, such as the failure of another run."""
        if run not in self._jobs:
            self._jobs[run] = self._completed(run)
        return self._jobs[run]

    def _completed(self, number: int) -> tuple[Job, str] | CaseRecord:
        run, values = self.plan.runs[number], {}
        for key, source in self._sources(number):
            taken, record = self.plan.study.series_called(run.place.series).take[key], self._first(source)
            if record is None:
                raise ValueError(f"run {number} is not ready")
            value = look_up(record.statistics, taken.key) if record.converged else None
            if value is None:
                why = "has failed" if not record.converged else f"has no number at {taken.key}"
                return _not_run(f"{key} is taken from series '{taken.series}', which {why}")
            values[key] = max(value, taken.at_least)
        try:
            job = run.job.with_(values) if values else run.job
        except JobError as error:
            return _not_run("; ".join(error.problems))
        # The hash of everything that the result and the time of a run depend on.
        return job, content_key(job, ranks=self.ranks, partition=job.mesh.partition)


def executions_in(plan: StudyPlan, directory: Path, ranks: int | None = None) -> Executions:
    """Return the executions of a study in a directory, for reading.

    Args:
        ranks: their number of ranks; by default the last start's.

    Raises:
        OutputError: the directory holds anything else than this study.
    """
    check_content(directory, plan.study.study)
    return Executions(plan, ledger_of(directory / STORE), ranks or ranks_in(directory))


def _not_run(why: str) -> CaseRecord:
    return CaseRecord(f"not run: {why}", "", {}, 0.0, 0)
