"""A study as a batch: each run is executed from the beginning, without reuse of earlier runs, since it is timed."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from hpcinv.base.parallel.code_cache import missing_count
from hpcinv.base.parallel.runtime import MPI
from hpcinv.driver import run
from hpcinv.errors import HpcinvError
from hpcinv.job.job import Job
from hpcinv.mesh import build_body
from hpcinv.output.progress import SilentProgress
from hpcinv.solver.workspace import collect_garbage
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.ledger import Ledger
from hpcinv.studies.batch.task import Batch, BatchTask, Pause, Runner
from hpcinv.studies.study.directory import STORE
from hpcinv.studies.study.executions import RETRY, Executions
from hpcinv.studies.study.study_plan import StudyPlan


@dataclass(frozen=True)
class StudyTask(BatchTask):
    """One execution of a run; ``number`` of the ``total`` that are known to be needed."""

    number: int
    total: int


class StudySchedule:
    """Schedule of the executions of a study: all first ones, then all second ones, …; on the first rank."""

    def __init__(self, plan: StudyPlan, ledger: Ledger, _begin: float, ranks: int) -> None:
        self.executions = Executions(plan, ledger, ranks)

    def next(self) -> StudyTask | Pause | None:
        """Claim an execution; ``None`` if all are finished."""
        known = self.executions
        known.read()
        for number, i, job in (open_ones := known.open_ones()):
            if (claim := known.ledger.claim(known.execution_key(i, number))) is not None:
                done, total = known.count()
                return StudyTask(known.plan.runs[i].place.title, job, claim, done + 1, total)
        return Pause.WAIT if open_ones else None  # other allocations hold the rest

    def report(self, task: StudyTask, record: CaseRecord) -> str:
        line = f"[{task.number}/{task.total}] {task.title}: "
        if not record.converged:
            return line + record.status
        seconds = record.statistics["timings"]["total"]
        return line + f"{seconds:.2f} s" + (", not counted: programs had to be made" if record.compiled else "")


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
        count_before = missing_count()
        run(task.job, self.comm, progress=progress, stop_asked=stop_asked)
        return {"compiled": self.comm.allreduce(missing_count() > count_before, op=MPI.LOR)}

    def clear(self) -> None:
        collect_garbage(self.comm)


def study_batch(plan: StudyPlan, directory: Path) -> Batch:
    """Return the executions of the runs of a study in a directory."""
    return Batch(directory / STORE, plan.study.limit, RETRY, partial(StudySchedule, plan), StudyRunner)


def _load_gmsh(job: Job, comm: MPI.Intracomm) -> None:
    """Make a mesh, so that loading gmsh does not count in the time of the first run."""
    with contextlib.suppress(HpcinvError):
        build_body(job.mesh, job.regions, comm, resolve=job.resolve)


def _reset_peak_memory() -> None:
    """Reset the peak memory of this process that the system measures (Linux only)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
