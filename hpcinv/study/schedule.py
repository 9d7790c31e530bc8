"""What a study does next: round after round over all runs, so that a machine that slows down is unfair to none."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hpcinv.errors import JobError
from hpcinv.job.content_key import content_key
from hpcinv.quantity.keys import look_up
from hpcinv.study.store import Record, Store

if TYPE_CHECKING:
    from hpcinv.job.job import Job
    from hpcinv.study.plan import Plan, Run


@dataclass(frozen=True)
class Task:
    """One execution that is due; ``number`` of the ``total`` that are known to be needed."""

    run: Run
    job: Job
    key: str
    number: int
    total: int


class Schedule:
    """The runs of a plan and their records; it lives on rank 0."""

    def __init__(self, plan: Plan, store: Store, ranks: int) -> None:
        self.plan, self.store, self.ranks = plan, store, ranks
        self._records: dict[str, list[Record]] = {}
        self._jobs: dict[int, tuple[Job, str] | Record] = {}
        self._by_place = {(r.place.ladder, r.place.step, r.place.case): i for i, r in enumerate(plan.runs)}
        self._tasks = self._rounds()
        ready = {self.key(i): i for i in range(len(plan.runs)) if self._is_ready(i)}
        self.reused = sum(len(self.records(i)) for key, i in ready.items() if key)

    def next(self) -> Task | None:
        """What is due, ``None`` when all is done."""
        return next(self._tasks, None)

    def keep(self, task: Task, record: Record) -> None:
        """Take in what came out of a task."""
        self.store.keep(task.key, record)
        self._records[task.key].append(record)

    def records(self, run: int) -> list[Record]:
        """What there is of a run, by its number in the plan."""
        found = self._job(run)
        if isinstance(found, Record):
            return [found]
        _, key = found
        if key not in self._records:
            self._records[key] = self.store.records(key)
        return self._records[key]

    def key(self, run: int) -> str:
        """The hash of a run's content; runs with the same one are the same. Empty for one that cannot begin."""
        found = self._job(run)
        return "" if isinstance(found, Record) else found[1]

    def _rounds(self) -> Iterator[Task]:
        for done in itertools.count():
            open_runs = [i for i in range(len(self.plan.runs)) if done == 0 or self._missing(i)]
            if not open_runs:
                return
            for i in open_runs:
                found = self._job(i)
                if not isinstance(found, Record) and self._missing(i) and len(self.records(i)) <= done:
                    yield Task(self.plan.runs[i], *found, *self._count())

    def _missing(self, run: int) -> int:
        """How many executions a run still needs: one more than its repetitions if one had to compile kernels."""
        records, wanted = self.records(run), self._repeat(run)
        if any(not record.converged for record in records):
            return 0
        return min(wanted - sum(record.timed for record in records), wanted + 1 - len(records))

    def _repeat(self, run: int) -> int:
        return self.plan.study.ladder(self.plan.runs[run].place.ladder).repeat or self.plan.study.repeat

    def _count(self) -> tuple[int, int]:
        """The number of the next execution, and of all."""
        ready = {i: self._is_ready(i) for i in range(len(self.plan.runs))}
        needed = {self.key(i): (len(self.records(i)), max(self._missing(i), 0)) for i, known in ready.items() if known}
        needed.pop("", None)  # those that cannot begin
        later = sum(self._repeat(i) for i, known in ready.items() if not known)
        done, missing = (sum(column) for column in zip(*needed.values(), strict=True))
        return done + 1, done + missing + later

    def _is_ready(self, run: int) -> bool:
        """Whether all that a run takes from others is known."""
        return run in self._jobs or all(self._is_ready(i) and bool(self.records(i)) for _, i in self._sources(run))

    def _sources(self, run: int) -> Iterator[tuple[str, int]]:
        """Keys that take their value from another run, with its number."""
        place = self.plan.runs[run].place
        for key, taken in self.plan.study.ladder(place.ladder).take.items():
            step = place.step if self.plan.study.ladder(taken.ladder).steps > 1 else 0
            yield key, self._by_place[taken.ladder, step, place.case]

    def _job(self, run: int) -> tuple[Job, str] | Record:
        """The job of a run and its hash, or why there is none: another run, from which it takes values, has failed."""
        if run not in self._jobs:
            job = self._completed(run)
            self._jobs[run] = job if isinstance(job, Record) else (job, self._key(job))
        return self._jobs[run]

    def _key(self, job: Job) -> str:
        """Hash of all that the result and the time of a run depend on."""
        return content_key(job, ranks=self.ranks, partition=job.mesh.partition)

    def _completed(self, number: int) -> Job | Record:
        run, values = self.plan.runs[number], {}
        for key, source in self._sources(number):
            taken, record = self.plan.study.ladder(run.place.ladder).take[key], self.records(source)[0]
            value = look_up(record.statistics, taken.key) if record.converged else None
            if value is None:
                why = "has failed" if not record.converged else f"has no number at {taken.key}"
                return Record(f"not run: '{taken.ladder}', which {key} is taken from, {why}", "", False, {})
            values[key] = max(value, taken.at_least)
        try:
            return run.with_values(values) if values else run.job
        except JobError as error:
            return Record(f"not run: {'; '.join(error.problems)}", "", False, {})
