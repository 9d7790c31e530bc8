"""Schedule of a study: rounds over all runs, so that a change in the speed of the machine affects all runs alike."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

from hpcinv.batch.ledger.record import CaseRecord
from hpcinv.batch.task import BatchTask, Pause
from hpcinv.study.executions import Executions


@dataclass(frozen=True)
class StudyTask(BatchTask):
    """One execution of a run; ``number`` of the ``total`` that are known to be needed."""

    number: int
    total: int


class StudySchedule:
    """Schedule of the open executions of a study; on the first rank."""

    def __init__(self, executions: Executions) -> None:
        self.executions = executions
        self._tasks = self._all()

    def next(self) -> StudyTask | Pause | None:
        """Claim an execution; ``None`` if all are finished."""
        return next(self._tasks, None)

    def report(self, task: StudyTask, record: CaseRecord) -> str:
        line = f"[{task.number}/{task.total}] {task.title}: "
        if not record.converged:
            return line + record.status
        seconds = record.statistics["timings"]["total"]
        return line + f"{seconds:.2f} s" + (", not counted: kernels had to be compiled" if record.compiled else "")

    def _all(self) -> Iterator[StudyTask | Pause]:
        while True:
            has_claimed = False
            for task in self._rounds():
                has_claimed = True
                yield task
            if self._is_finished():
                return
            if not has_claimed:  # other allocations hold the rest
                yield Pause.WAIT
            self.executions.read()

    def _rounds(self) -> Iterator[StudyTask]:
        """Yield all first executions, then all second ones, …, except those that others hold."""
        known = self.executions
        runs = range(len(known.plan.runs))
        for number in itertools.count():
            left = [i for i in runs if number == 0 or (known.is_ready(i) and number < known.needed(i))]
            if not left:
                return
            for i in left:
                # Further executions of a run begin when the first one has converged.
                if known.is_ready(i) and number < known.needed(i) and (number == 0 or known.is_known(i, 0)):
                    yield from self._claimed(i, number)

    def _claimed(self, run: int, number: int) -> Iterator[StudyTask]:
        """Yield one execution of a run, if it is open and not held."""
        known = self.executions
        job = known.job(run)
        if job is None or known.is_known(run, number):
            return
        claim = known.ledger.claim(known.execution_key(run, number))
        if claim is not None:
            done, total = known.count()
            yield StudyTask(known.plan.runs[run].place.title, job, claim, done + 1, total)
        known.read_one(run, number)

    def _is_finished(self) -> bool:
        known = self.executions
        return all(
            known.is_ready(i) and all(known.is_known(i, n) for n in range(known.needed(i)))
            for i in range(len(known.plan.runs))
        )
