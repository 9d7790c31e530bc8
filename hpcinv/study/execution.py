"""A study as a batch: each run is executed from the beginning, without reuse of earlier runs, since it is timed."""

import contextlib
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from hpcinv.batch.ledger.ledger import Ledger
from hpcinv.batch.ledger.record import CaseRecord
from hpcinv.batch.task import Batch, BatchTask, Pause, Runner
from hpcinv.driver import run
from hpcinv.errors import HpcinvError
from hpcinv.job.job import Job
from hpcinv.mesh import build_body
from hpcinv.output.progress import SilentProgress
from hpcinv.parallel.jit import NOT_FOUND
from hpcinv.parallel.runtime import MPI
from hpcinv.solver.problem_cache import collect_garbage
from hpcinv.study.directory import store_in
from hpcinv.study.executions import RETRY, Executions
from hpcinv.study.plan import StudyPlan


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
            known.read()

    def _is_finished(self) -> bool:
        known = self.executions
        return all(
            known.is_ready(i) and all(known.is_known(i, n) for n in range(known.needed(i)))
            for i in range(len(known.plan.runs))
        )


class StudyRunner(Runner[StudyTask]):
    """Executes runs on all ranks of ``comm``; writes no files."""

    def __init__(self, comm: MPI.Intracomm) -> None:
        self.comm = comm
        self._is_first = True

    def run(self, task: StudyTask, progress: SilentProgress, stop_asked: Callable[[], bool]) -> dict[str, Any]:
        if self._is_first:
            _load_gmsh(task.job, self.comm)
            self._is_first = False
        _reset_peak_memory()
        before = len(NOT_FOUND)
        run(task.job, self.comm, progress=progress, stop_asked=stop_asked)
        return {"compiled": self.comm.allreduce(len(NOT_FOUND) > before, op=MPI.LOR)}

    def clear(self) -> None:
        collect_garbage(self.comm)


def study_batch(plan: StudyPlan, directory: Path) -> Batch:
    """Return the executions of the runs of a study in a directory."""
    return Batch(store_in(directory), plan.study.limit, RETRY, partial(_schedule, plan), StudyRunner)


def _schedule(plan: StudyPlan, ledger: Ledger, _begin: float, ranks: int) -> StudySchedule:
    return StudySchedule(Executions(plan, ledger, ranks))


def _load_gmsh(job: Job, comm: MPI.Intracomm) -> None:
    """Make a mesh, so that loading gmsh does not count in the time of the first run."""
    with contextlib.suppress(HpcinvError):
        build_body(job.mesh, job.regions, comm, resolve=job.resolve)


def _reset_peak_memory() -> None:
    """Reset the peak memory of this process that the system measures (Linux only)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
