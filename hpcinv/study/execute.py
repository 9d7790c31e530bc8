"""Running what a study still lacks, one job after the other on all ranks."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hpcinv.driver import run
from hpcinv.errors import HpcinvError, Interrupted, JobError, MeshError, SolveError
from hpcinv.mesh import build_body
from hpcinv.output.progress import Listener
from hpcinv.parallel.runtime import MPI, on_root
from hpcinv.solver.problem_cache import collect_garbage
from hpcinv.study.store import Record

if TYPE_CHECKING:
    from hpcinv.job.job import Job
    from hpcinv.study.schedule import Schedule, Task


def execute(
    schedule: Schedule | None,
    comm: MPI.Intracomm,
    *,
    note: Callable[[str], None] = lambda text: None,
    stop_asked: Callable[[], bool] = lambda: False,
) -> None:
    """Run all that is due; collective.

    Args:
        schedule: on rank 0, ``None`` on the others.
        note: told of each run when it has ended.
        stop_asked: asked on every rank.

    Raises:
        Interrupted: ``stop_asked`` was true on some rank; what was done is kept.
        OutputError: on every rank, if it cannot be kept.
    """

    def due() -> Task | None:
        assert schedule is not None
        return schedule.next()

    fresh = True
    while (task := on_root(comm, due)) is not None:
        if comm.allreduce(stop_asked(), op=MPI.LOR):
            raise _interrupted(task)
        if fresh:
            _load_what_meshes_need(task.job, comm)
            fresh = False
        try:
            record = execute_once(task.job, comm, stop_asked)
        except Interrupted:
            raise _interrupted(task) from None
        on_root(comm, partial(_keep, schedule, task, record))
        note(_line(task, record))


def execute_once(job: Job, comm: MPI.Intracomm, stop_asked: Callable[[], bool] = lambda: False) -> Record:
    """Run a job, without writing anything; a job that cannot be solved is a result too. Collective.

    Raises:
        Interrupted: it was stopped.
    """
    heard = Listener(comm)
    _forget_peak_memory()
    before = _compilers()
    status, advice = "converged", ""
    try:
        run(job, comm, progress=heard, stop_asked=stop_asked)
    except (SolveError, MeshError) as error:
        status, advice = error.message, error.advice
    except JobError as error:  # a formula without a value
        status = "; ".join(error.problems)
    compiled = comm.allreduce(_compilers() > before, op=MPI.LOR)
    collect_garbage(comm)
    return Record(status, advice, timed=status == "converged" and not compiled, statistics=heard.statistics)


def _keep(schedule: Schedule | None, task: Task, record: Record) -> None:
    assert schedule is not None
    schedule.keep(task, record)


def _line(task: Task, record: Record) -> str:
    line = f"[{task.number}/{task.total}] {task.run.place.title}: "
    if not record.converged:
        return line + record.status
    seconds = record.statistics["timings"]["total"]
    return line + f"{seconds:.2f} s" + ("" if record.timed else ", not counted: kernels had to be compiled")


def _interrupted(task: Task) -> Interrupted:
    return Interrupted(
        f"stopped by a signal; {task.number - 1} of {task.total} runs are done and kept",
        "The same command goes on from there.",
    )


def _load_what_meshes_need(job: Job, comm: MPI.Intracomm) -> None:
    """The first mesh of a process pays for loading gmsh, which is not to be counted in the time of any run."""
    with contextlib.suppress(HpcinvError):
        build_body(job.mesh, job.regions, comm, resolve=job.resolve)


def _compilers() -> float:
    """Processor time of the processes that this one has started so far: compilers of kernels."""
    used = os.times()
    return used.children_user + used.children_system


def _forget_peak_memory() -> None:
    """Let the system measure the largest memory of this process anew, where it can (Linux)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
