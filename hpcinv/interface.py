"""Python interface of a run: jobs by their files or contents, and messages as on a terminal."""

import sys
from collections.abc import Mapping
from contextlib import ExitStack
from os import PathLike
from pathlib import Path
from typing import Any

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.driver import run as run_job
from hpcinv.errors import JobError
from hpcinv.job.job import Job, load
from hpcinv.output.progress import Progress
from hpcinv.output.result import Result
from hpcinv.output.run_directory import RunDirectory


def run(
    job: Job | str | PathLike[str] | Mapping[str, Any],
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    *,
    directory: str | PathLike[str] | RunDirectory | None = None,
    overwrite: bool = False,
    resume: bool = False,
    progress: bool | Progress = True,
    **further: Any,
) -> Result:
    """Solve a job on all ranks of ``comm``; collective.

    Args:
        job: as `load` returns it, or a file or mapping that `load` reads.
        directory: of checkpoints and results; ``None`` writes nothing.
        overwrite: whether results of another run may be replaced.
        resume: continue from the last checkpoint in ``directory``, if there is one.
        progress: whether rank 0 prints what ``hpcinv run`` prints; or an object that receives it.
        further: ``stop_asked``, ``workspace`` and ``guesses`` of `hpcinv.driver.run`.

    Raises:
        JobError, MeshError, OutputError, CheckpointError, SystemPartMissing: the same on every rank.
        SolveError: the load was not reached; the diagnosis is in the message and in ``summary.json``.
        Interrupted: ``stop_asked`` was true on some rank.
    """
    if not isinstance(job, Job):
        given = job
        job = on_root(comm, lambda: load(given))
    if isinstance(directory, str | PathLike):
        directory = Path(directory)
    elif directory is not None and not isinstance(directory, RunDirectory):
        raise JobError(f"directory: must be a path, not {directory!r}")
    with ExitStack() as own:
        if not isinstance(progress, Progress):
            progress = own.enter_context(Progress(comm, sys.stdout if progress else None))
        return run_job(job, comm, directory=directory, overwrite=overwrite, resume=resume, progress=progress, **further)
