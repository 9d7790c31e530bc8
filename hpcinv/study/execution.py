"""A study as a batch: each run is executed from the beginning, without reuse of earlier runs, since it is timed."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hpcinv.batch.ledger.ledger import Ledger
from hpcinv.batch.task import Batch, Runner
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
from hpcinv.study.schedule import StudySchedule, StudyTask


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


@dataclass(frozen=True)
class StudyBatch(Batch):
    """The executions of the runs of a study in a directory."""

    plan: StudyPlan
    directory: Path
    retry = RETRY

    @property
    def store(self) -> Path:
        return store_in(self.directory)

    @property
    def limit(self) -> float | None:
        return self.plan.study.limit

    def schedule(self, ledger: Ledger, begin: float, ranks: int) -> StudySchedule:
        return StudySchedule(Executions(self.plan, ledger, ranks))

    def runner(self, comm: MPI.Intracomm) -> StudyRunner:
        return StudyRunner(comm)


def _load_gmsh(job: Job, comm: MPI.Intracomm) -> None:
    """Make a mesh, so that loading gmsh does not count in the time of the first run."""
    with contextlib.suppress(HpcinvError):
        build_body(job.mesh, job.regions, comm, resolve=job.resolve)


def _reset_peak_memory() -> None:
    """Reset the peak memory of this process that the system measures (Linux only)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
