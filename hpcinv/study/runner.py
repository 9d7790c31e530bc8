"""How a run of a study is executed: from the beginning, with nothing left by the runs before it, since it is timed."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.batch.task import Runner
from hpcinv.driver import run
from hpcinv.errors import HpcinvError
from hpcinv.mesh import build_body
from hpcinv.parallel.runtime import MPI
from hpcinv.solver.problem_cache import collect_garbage
from hpcinv.study.schedule import StudyTask

if TYPE_CHECKING:
    from hpcinv.job.job import Job
    from hpcinv.output.progress import Listener


class StudyRunner(Runner[StudyTask]):
    """Executes runs on all ranks of ``comm``, without writing anything."""

    def __init__(self, comm: MPI.Intracomm) -> None:
        self.comm = comm
        self._is_first = True

    def run(self, task: StudyTask, heard: Listener, stop_asked: Callable[[], bool]) -> dict[str, Any]:
        if self._is_first:
            _load_what_meshes_need(task.job, self.comm)
            self._is_first = False
        _forget_peak_memory()
        before = _compilers()
        run(task.job, self.comm, progress=heard, stop_asked=stop_asked)
        return {"compiled": self.comm.allreduce(_compilers() > before, op=MPI.LOR)}

    def clear(self) -> None:
        collect_garbage(self.comm)


def _load_what_meshes_need(job: Job, comm: MPI.Intracomm) -> None:
    """The first mesh of a process pays for loading gmsh, which is not to be counted in the time of any run."""
    with contextlib.suppress(HpcinvError):
        build_body(job.mesh, job.regions, comm, resolve=job.resolve)


def _compilers() -> float:
    """Processor time of the processes that this one has started and that have ended: compilers of kernels."""
    used = os.times()
    return used.children_user + used.children_system


def _forget_peak_memory() -> None:
    """Let the system measure the largest memory of this process from now on, where it can (Linux)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
