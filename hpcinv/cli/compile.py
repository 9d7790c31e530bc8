"""``hpcinv compile``: make all programs of jobs, studies and sweeps before they run."""

import argparse
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hpcinv.base.files.untrusted import add_option
from hpcinv.base.quantity.keys import parse_key
from hpcinv.cli.help import add_command
from hpcinv.errors import HpcinvError, Interrupted
from hpcinv.job.fingerprint import NOT_PHYSICS
from hpcinv.job.job import Job, load
from hpcinv.job.kind_of_file import is_study, is_sweep
from hpcinv.job.reuse_key import kernel_key
from hpcinv.studies.study.study_plan import load_study
from hpcinv.studies.sweep.sweep_plan import Case, load_sweep


def add_compile(commands: Any) -> None:
    command = add_command(
        commands,
        "compile",
        "Make what jobs evaluate at points, without solving (in parallel under mpirun).",
        examples=("hpcinv compile jobs/pdms-beam.yaml\nmpirun -n 4 hpcinv compile sweep.yaml --cache /shared/kernels"),
        page="how-to/start-up.md",
    )
    command.add_argument("jobs", type=Path, nargs="+", metavar="file", help="job, study or sweep file (YAML)")
    command.add_argument(
        "--cache",
        type=Path,
        metavar="DIR",
        help="directory of the programs, for runs with HPCINV_KERNELS=DIR (default: $HPCINV_KERNELS)",
    )
    add_option(command)
    command.set_defaults(command=_compile)


def _compile(options: argparse.Namespace) -> int:
    if options.cache is not None:
        os.environ["HPCINV_KERNELS"] = str(options.cache)

    from hpcinv.base.parallel.launch import launched

    with launched(None) as (comm, stop):
        from hpcinv.base.parallel.jit import DIRECTORY
        from hpcinv.base.parallel.runtime import MPI, agree, compilation_explained, on_root
        from hpcinv.cli.rehearsal import rehearse

        jobs = on_root(comm, lambda: list(_distinct(options.jobs)))
        ready_before = _ready(DIRECTORY)
        comm.Barrier()
        error: HpcinvError | None = None
        try:
            for job in jobs[comm.rank :: comm.size]:
                if stop():
                    raise Interrupted("stopped by a signal", "The same command goes on.")
                with compilation_explained(MPI.COMM_SELF):
                    rehearse(job)
                print(f"{job.job}: ready", flush=True)
        except HpcinvError as found:
            error = found
        agree(comm, error)
        on_root(comm, lambda: print(f"{_ready(DIRECTORY) - ready_before} programs made; they are in {DIRECTORY}"))
    return 0


def _distinct(paths: list[Path]) -> Iterator[Job]:
    """Yield the jobs of these files, one for each set of kernels."""
    known = set[str]()
    for path in paths:
        if is_sweep(path):
            plan = load_sweep(path)
            jobs = [plan.job(case) for case in {_kind_of(case): case for case in reversed(plan.cases)}.values()]
        else:
            jobs = [run.job for run in load_study(path).runs] if is_study(path) else [_differentiated(load(path))]
        for job in jobs:
            if (kernels := kernel_key(job)) not in known:
                known.add(kernels)
                yield job


def _kind_of(case: Case) -> tuple[str, str]:
    """Return the reuse group of a case, and what it sets outside of the physics, as text."""
    return case.reuse_group, repr([(key, v) for key, v in case.settings.items() if parse_key(key)[0] in NOT_PHYSICS])


def _differentiated(job: Job) -> Job:
    """Return the job, one with a section ``identify`` also with the derivatives that this needs."""
    if job.identify is None:
        return job
    given = {number.key: {"sd": number.deviation, **number.tied_keys} for number in job.differentiated}
    tied = {tie.key for number in job.differentiated for tie in number.ties}
    return job.with_(
        {"sensitivities": given | {key: None for key in job.identify.keys if key not in tied | given.keys()}}
    )


def _ready(directory: Path) -> int:
    return sum(1 for pattern in ("*.so", "*.npz") for _ in directory.glob(pattern))
