"""Command line: ``python -m hpcinv run | resume | study | sweep | mesh | bench | …``; ``--help`` lists them all."""

from __future__ import annotations

from hpcinv.parallel.signals import note_while_starting, starting_is_over

if __name__ == "__main__":
    note_while_starting()  # the imports below take a while

import argparse
import io
import json
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from hpcinv.cli.bench import add_bench
from hpcinv.cli.compile import add_compile
from hpcinv.cli.mesh import add_mesh
from hpcinv.cli.sweep import add_sweep
from hpcinv.errors import HpcinvError, OutputError
from hpcinv.files.untrusted import add_option, asked_for
from hpcinv.job.job import Job, json_schema, load
from hpcinv.output.run_directory import RunDirectory, choose
from hpcinv.parallel.early_exit import refuse_exit_without_end
from hpcinv.parallel.signals import CLOSED_OUTPUT, discard_output, end_on_interrupt
from hpcinv.study.plan import is_study, load_plan
from hpcinv.sweep.plan import is_sweep, load_sweep
from hpcinv.version import __version__

if TYPE_CHECKING:
    from hpcinv.quantity.component import Ingredient

EPILOG = """exit codes: 0 success, 1 internal error, 2 wrong job, mesh or output directory, 3 the load was not reached,
4 no usable checkpoint, 5 a system part is missing, 6 the certificate fails, 7 it has warnings or is
not decided (--strict), 75 stopped by SIGTERM or SIGUSR1 (resume it), 130 Ctrl-C,
141 nobody reads the output any more"""


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit code."""
    sys.stdout = sys.stdout or io.StringIO()  # it may be closed
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a file name may be no text
    options = _parser().parse_args(arguments)
    starting_is_over()
    try:
        with asked_for(options):
            code: int = options.command(options)
        sys.stdout.flush()
    except HpcinvError as error:
        if not _is_other_rank():
            print(error, file=sys.stderr)
        return error.exit_code
    except BrokenPipeError:
        discard_output()
        return CLOSED_OUTPUT
    except OSError as error:
        print(f"{error.filename or 'what is printed'}: cannot be written or read: {error.strerror}", file=sys.stderr)
        return OutputError.exit_code
    except KeyboardInterrupt:
        return 130
    return code


def _is_other_rank() -> bool:
    """Whether a launcher started this process beside another that says the same, as far as it is known without MPI."""
    return any(os.environ.get(name, "0") != "0" for name in ("PMI_RANK", "PMIX_RANK", "OMPI_COMM_WORLD_RANK"))


def _validate(options: argparse.Namespace) -> int:
    """Needs neither MPI nor DOLFINx, so that it is instant on a login node."""
    failed = 0
    for path in options.jobs:
        try:
            (load_plan if is_study(path) else load_sweep if is_sweep(path) else load)(path)
        except HpcinvError as error:
            print(error, file=sys.stderr)
            failed = error.exit_code
        else:
            print(f"{path}: valid")
    return failed


def _schema(_options: argparse.Namespace) -> int:
    print(json.dumps(json_schema(), indent=2))
    return 0


def _laws(options: argparse.Namespace) -> int:
    from hpcinv.materials import laws

    return _catalogue(laws(), "law", options.name)


def _effects(options: argparse.Namespace) -> int:
    from hpcinv.effects import effects

    return _catalogue(effects(), "effect", options.name)


def _formulas(_options: argparse.Namespace) -> int:
    from hpcinv.cli.formula_guide import show

    show()
    return 0


def _catalogue(members: Mapping[str, type[Ingredient]], tag: str, name: str | None) -> int:
    from hpcinv.cli.catalogue import describe, overview

    if name is None:
        overview(members)
    else:
        describe(members, tag, name)
    return 0


def _explain(options: argparse.Namespace) -> int:
    from hpcinv.parallel.runtime import MPI, compilation_explained, failing_together, on_root

    comm = MPI.COMM_WORLD
    with failing_together(comm):
        job = on_root(comm, lambda: load(options.job))

        from hpcinv.cli.explain import explain
        from hpcinv.cli.explanation import show

        def note(text: str) -> None:
            if comm.rank == 0:
                print(text, file=sys.stderr, flush=True)

        with compilation_explained(comm):
            found = explain(job, comm, note)
        if comm.rank == 0:
            show(job, found)
    return 0


def _run(options: argparse.Namespace) -> int:
    def read() -> tuple[Job, RunDirectory]:
        job = load(options.job)
        directory = choose(options.output, job)
        directory.check_free(overwrite=options.overwrite)
        return job, directory

    return _in_parallel(options, read, resume=False)


def _resume(options: argparse.Namespace) -> int:
    if options.untrusted:
        directory = options.directory
        text = f"{directory}: --untrusted: checkpoints that came from elsewhere are not read"
        anew = f"Start anew with 'run --untrusted {directory / 'job.yaml'}'"
        raise OutputError(text, f"{anew}; a run of your own that began with --untrusted keeps to it by itself.")

    def read() -> tuple[Job, RunDirectory]:
        directory = RunDirectory(options.directory)
        return directory.job(options.job), directory

    return _in_parallel(options, read, resume=True)


def _in_parallel(options: argparse.Namespace, read: Callable[[], tuple[Job, RunDirectory]], *, resume: bool) -> int:
    """Read the job on rank 0 and solve it on all."""
    from hpcinv.parallel.launch import launched

    with launched(options.ranks) as (comm, stop):
        from hpcinv.output.progress import Level, Progress
        from hpcinv.parallel.runtime import abort, on_root

        with Progress(comm, sys.stdout, Level(1 + options.verbose - options.quiet)) as progress:

            def interrupted() -> NoReturn:
                progress.note("ended by Ctrl-C", Level.VERBOSE)
                progress.close()  # gives the terminal its cursor back
                abort(comm, 130)

            end_on_interrupt(interrupted)
            job, directory = on_root(comm, read)
            if resume and on_root(comm, lambda: directory.is_finished):
                progress.note(f"{directory.path}: this run is finished; its results are in summary.json")
                return 0

            from hpcinv.driver import run

            result = run(
                job,
                comm,
                directory=directory.path,
                overwrite=not resume and options.overwrite,
                resume=resume,
                progress=progress,
                stop_asked=stop,
            )
    return result.certificate.verdict.exit_code(strict=options.strict)


def _study(options: argparse.Namespace) -> int:
    from hpcinv.parallel.launch import launched

    with launched(options.ranks) as (comm, stop):
        from hpcinv.cli.study import conduct
        from hpcinv.parallel.runtime import on_root

        plan = on_root(comm, lambda: load_plan(options.study))

        def note(text: str) -> None:
            if comm.rank == 0:
                print(text, flush=True)

        directory = options.output or Path("results") / plan.study.study
        conduct(plan, comm, directory=directory, note=note, stop_asked=stop)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="hpcinv", description="The undeformed shape of a soft body from its deformed one.", epilog=EPILOG
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="command")

    run = commands.add_parser("run", help="solve a job (under mpirun for more than one rank)")
    run.add_argument("job", type=Path, help="job file (YAML)")
    run.add_argument(
        "--output", type=Path, metavar="DIR", help="where results go (default: results/JOB, then JOB-2, …)"
    )
    run.add_argument("--overwrite", action="store_true", help="replace the results of the run in --output")
    run.set_defaults(command=_run)

    resume = commands.add_parser("resume", help="go on with a run from its last checkpoint, on any number of ranks")
    resume.add_argument("directory", type=Path, help="directory of the run")
    resume.add_argument("--job", type=Path, help="a changed job: solver, output and checkpoint settings may differ")
    resume.set_defaults(command=_resume)

    study = commands.add_parser("study", help="accuracy against time: many runs of a job, their errors and costs")
    study.add_argument("study", type=Path, help="study file (YAML)")
    study.add_argument("--output", type=Path, metavar="DIR", help="where it goes, and goes on (default: results/STUDY)")
    study.set_defaults(command=_study)

    add_sweep(commands)
    add_mesh(commands)
    add_compile(commands)
    add_bench(commands)

    for parallel in (run, resume):
        told = parallel.add_mutually_exclusive_group()
        told.add_argument("-v", "--verbose", action="store_true", help="print every iteration of Newton's method")
        told.add_argument("-q", "--quiet", action="store_true", help="print warnings, what fails, and how it ended")
        parallel.add_argument(
            "--strict",
            action="store_true",
            help="end with exit code 7 if the certificate has warnings or is not decided",
        )
    for parallel in (run, resume, study):
        parallel.add_argument(
            "--ranks", type=int, help="refuse to run on another number of ranks (a launcher can start N runs of one)"
        )

    validate = commands.add_parser("validate", help="check job, study and sweep files without running them")
    validate.add_argument("jobs", type=Path, nargs="+", metavar="file", help="job, study or sweep file (YAML)")
    validate.set_defaults(command=_validate)

    explain = commands.add_parser("explain", help="show what a job's scene contains, and measure what each part costs")
    explain.add_argument("job", type=Path, help="job file (YAML)")
    explain.set_defaults(command=_explain)

    for reading in (run, resume, study, validate, explain):
        add_option(reading)

    for name, command in (("laws", _laws), ("effects", _effects)):
        catalogue = commands.add_parser(name, help=f"list the {name}, or show all about one")
        catalogue.add_argument("name", nargs="?", help="its name in job files")
        catalogue.set_defaults(command=command)

    formulas = commands.add_parser(
        "formulas", help="list the functions and names of formulas, and where each may be used"
    )
    formulas.set_defaults(command=_formulas)

    schema = commands.add_parser("schema", help="print the JSON Schema of job files, for editors")
    schema.set_defaults(command=_schema)
    return parser


if __name__ == "__main__":
    refuse_exit_without_end()
    sys.exit(main())
