"""Commands ``run`` and ``resume``; under mpirun for more than one rank."""

import argparse
import sys
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from hpcinv.base.files.untrusted import add_option
from hpcinv.base.parallel.imports import paused_collection
from hpcinv.base.parallel.signals import STOPPED, end_on_interrupt
from hpcinv.cli.help import add_command
from hpcinv.cli.options import add_ranks
from hpcinv.errors import OutputError
from hpcinv.job.job import Job, load
from hpcinv.job.settings import LEVELS
from hpcinv.output.run_directory import RunDirectory, choose


def add_run(commands: Any) -> None:
    run = add_command(
        commands,
        "run",
        "Solve a job (under mpirun for more than one rank).",
        examples=(
            "hpcinv run jobs/pdms-beam.yaml\nmpirun -n 4 hpcinv run jobs/pdms-beam.yaml --output results/beam --strict"
        ),
        page="start/results.md",
    )
    run.add_argument("job", type=Path, help="job file (YAML)")
    run.add_argument(
        "--output", type=Path, metavar="DIR", help="where results go (default: results/JOB, then JOB-2, …)"
    )
    run.add_argument("--overwrite", action="store_true", help="replace the run in --output (default: results/JOB)")
    run.set_defaults(command=_run)

    resume = add_command(
        commands,
        "resume",
        "Continue a run from its last checkpoint, on any number of ranks.",
        examples="mpirun -n 3 hpcinv resume results/pdms-beam",
        page="how-to/interruptions.md",
    )
    resume.add_argument("directory", type=Path, help="directory of the run")
    resume.add_argument("--job", type=Path, help="a changed job: solver, output and checkpoint settings may differ")
    resume.set_defaults(command=_resume)

    for parallel in (run, resume):
        parallel.add_argument(
            "--certificate", choices=LEVELS, help="level of the certificate, instead of the job's section of that name"
        )
        verbosity = parallel.add_mutually_exclusive_group()
        verbosity.add_argument("-v", "--verbose", action="store_true", help="print every iteration of Newton's method")
        verbosity.add_argument(
            "-q", "--quiet", action="store_true", help="print only warnings, failures and the end of the run"
        )
        parallel.add_argument(
            "--strict",
            action="store_true",
            help="end with exit code 7 if the certificate has warnings or is not decided",
        )
        add_ranks(parallel)
        parallel.add_argument(
            "--report",
            action="store_true",
            help="write report.html, as does 'report: true' in the job's section output",
        )
        add_option(parallel)


def _run(options: argparse.Namespace) -> int:
    def read() -> tuple[Job, RunDirectory]:
        with paused_collection():
            job = _with_options(load(options.job), options)
        directory = choose(options.output, job, overwrite=options.overwrite)
        directory.check_free(overwrite=options.overwrite)
        return job, directory

    return _run_in_parallel(options, read, resume=False)


def _with_options(job: Job, options: argparse.Namespace) -> Job:
    """Return the job with the report and the level of the certificate that the options ask for."""
    changes = {"output.report": True} if options.report else {}
    changes |= {} if options.certificate is None else {"certificate": options.certificate}
    return job.with_(changes) if changes else job


def _resume(options: argparse.Namespace) -> int:
    if options.untrusted:
        directory = options.directory
        text = f"{directory}: --untrusted: checkpoints that came from elsewhere are not read"
        again = f"Start it again with 'run --untrusted {directory / 'job.yaml'}'"
        raise OutputError(text, f"{again}; a run that you have started with --untrusted is resumed so without it.")

    def read() -> tuple[Job, RunDirectory]:
        directory = RunDirectory(options.directory)
        job = directory.job(options.job)
        directory.check_same_problem(job)
        return _with_options(job, options), directory

    return _run_in_parallel(options, read, resume=True)


def _import_console() -> None:
    """Import what only rank 0 needs, so that all ranks end if it cannot be imported."""
    import hpcinv.output.console  # noqa: F401


def _run_in_parallel(options: argparse.Namespace, read: Callable[[], tuple[Job, RunDirectory]], *, resume: bool) -> int:
    from hpcinv.base.parallel.launch import launched

    with launched(options.ranks) as (comm, stop):
        with paused_collection():
            from hpcinv.base.parallel.ranks import abort, on_root
            from hpcinv.mesh.io.isolated import reading_ahead
            from hpcinv.output.progress import Level, Progress

        on_root(comm, _import_console)
        with ExitStack() as ahead, Progress(comm, sys.stdout, Level(1 + options.verbose - options.quiet)) as progress:

            def interrupted() -> NoReturn:
                progress.note("ended by Ctrl-C", Level.VERBOSE)
                progress.close()  # gives the terminal its cursor back
                abort(comm, 130)

            end_on_interrupt(interrupted)
            job, directory = on_root(comm, read)
            if comm.rank == 0:
                ahead.enter_context(reading_ahead(job.mesh, job.resolve(job.mesh.file)))
            with paused_collection():
                from hpcinv.driver import run
                from hpcinv.trust.certificate import Verdict

            if resume and on_root(comm, lambda: directory.is_finished):
                verdict = Verdict.named(on_root(comm, lambda: directory.verdict))
                results = f"its results are in summary.json, certificate: {verdict.value}"
                progress.note(f"{directory.path}: this run is finished; {results}")
                has_settings = bool(options.job or options.certificate)
                if has_settings and not on_root(comm, lambda: directory.holds(job)):
                    progress.warn("settings that differ from its job.yaml were not used; 'run' uses them")
                return verdict.exit_code(strict=options.strict)

            result = run(
                job,
                comm,
                directory=directory.path,
                overwrite=not resume and options.overwrite,
                resume=resume,
                progress=progress,
                stop_asked=stop,
                end_late=partial(abort, comm, STOPPED),
            )
    missing = OutputError.exit_code if result.statistics["unwritten"] else 0
    return result.certificate.verdict.exit_code(strict=options.strict) or missing
