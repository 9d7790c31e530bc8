"""Submission of a sweep to Slurm: batch scripts from templates, their jobs, and a job that collects the results."""

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from hpcinv.base.files.atomic import output_errors, replace
from hpcinv.base.reading.door import VARIABLE, is_asked
from hpcinv.errors import OutputError, SubmitError
from hpcinv.studies.batch.ledger.store import open_store
from hpcinv.studies.sweep.sweep_plan import SweepPlan, load_sweep
from hpcinv.studies.sweep.templates import TEMPLATES

LEAD = 120
"""seconds before the time limit at which the templates let Slurm send USR1; more leave less time to solve"""
_LIMIT = re.compile(r"(?:(\d+)-)?(\d+)(?::(\d+))?(?::(\d+))?")


def add_submit(action: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the command; ``action`` makes a parser from name, function, sentence and options of an example."""
    parser = action(
        "submit",
        _submit,
        "Submit a sweep to Slurm, which requeues it at time limits and writes its table at the end.",
        "--ntasks 64 --time 08:00:00",
    )
    parser.add_argument(
        "--ntasks", type=int, required=True, metavar="N", help="number of ranks (with --array, of each task)"
    )
    parser.add_argument("--ranks-per-case", type=int, default=1, metavar="K", help="ranks that solve a case together")
    parser.add_argument("--array", type=int, metavar="M", help="a job array of M tasks instead of one allocation")
    parser.add_argument("--time", metavar="HH:MM:SS", help="time limit, as sbatch takes it (default: the site's)")
    text = f"seconds before the time limit at which it saves and stops (default: {LEAD})"
    parser.add_argument("--lead", type=int, metavar="S", help=text)
    parser.add_argument(
        "--sbatch",
        action="append",
        default=[],
        metavar="OPTION",
        help="any other long option of sbatch, without its dashes, such as account=soft-matter; may be repeated",
    )
    parser.add_argument("--dry-run", action="store_true", help="write the scripts and show them, but submit nothing")


def _submit(options: argparse.Namespace) -> int:
    ranks = options.ranks_per_case
    if ranks < 1 or options.ntasks % ranks:
        raise SubmitError(
            f"--ranks-per-case {ranks}: {options.ntasks} ranks cannot be divided into groups of that size",
            "Ask for a multiple of it with --ntasks.",
        )
    limit, lead = _seconds(options.time), LEAD if options.lead is None else options.lead
    if limit is not None and limit <= lead:
        raise SubmitError(
            f"--time {options.time}: is not above the {lead} s that are kept for saving (--lead)",
            "It would be stopped before it can save anything: give it more time, or a smaller --lead.",
        )
    plan = load_sweep(options.sweep)
    open_store(plan.store)  # fails here, rather than in the queue, if the store cannot be written
    directory = plan.results
    run, collect = _write_scripts(plan, options, directory)
    print(f"{plan.sweep.sweep}: {len(plan.cases)} cases; store {plan.store}")
    if options.dry_run:
        for script in (run, collect):
            print(f"\n==> {script} <==\n{script.read_text('utf-8')}", end="")
        return 0
    job = sbatch(run)
    print(f"job {job}: runs it, by {run}")
    try:
        collecting = sbatch(f"--dependency=afterany:{job}", "--kill-on-invalid-dep=yes", collect)
    except SubmitError as error:
        advice = f"Job {job} is submitted nevertheless; when it has ended, use 'sweep table'."
        raise SubmitError(error.message, advice) from None
    print(f"job {collecting}: writes {directory / 'table.csv'} and table.h5 when job {job} has ended, by {collect}")
    print(f"watch them: squeue --jobs={job},{collecting}; tail -f {directory / 'slurm'}/*.out")
    print(f"watch the cases: python -m hpcinv sweep status {shlex.quote(str(options.sweep))} --follow")
    return 0


def _seconds(limit: str | None) -> int | None:
    """Return a time limit as Slurm reads it, such as ``90``, ``1:30:00`` or ``2-12`` (days, hours); else ``None``."""
    match = _LIMIT.fullmatch(limit or "")
    if match is None:
        return None
    days, first, second, third = (int(part or 0) for part in match.groups())
    if match[1] is None and match[4] is None:  # minutes and seconds
        return 60 * first + second
    return 86400 * days + 3600 * first + 60 * second + third


def _write_scripts(plan: SweepPlan, options: argparse.Namespace, directory: Path) -> tuple[Path, Path]:
    """Write the scripts of a sweep, templates with options and arguments: one to run it, one to collect the results."""
    name, place, sweep = plan.sweep.sweep, directory / "slurm", str(options.sweep)
    others = [option.lstrip("-") for option in options.sbatch]
    run = filled(
        TEMPLATES / ("sweep.sbatch" if options.array is None else "sweep-array.sbatch"),
        [f"job-name={name}", *_resources(options, place), *others],
        [sweep, str(options.ranks_per_case)],
    )
    # Both jobs need account and partition; the second one needs the least resources.
    collect = filled(
        TEMPLATES / "collect.sbatch",
        [f"job-name={name}-collect", f"output={place}/collect-%j.out", *others, "nodes=1", "ntasks=1"],
        [sweep, str(directory)],
    )
    run_script, collect_script = place / "run.sbatch", place / "collect.sbatch"
    with output_errors(place):
        place.mkdir(parents=True, exist_ok=True)
        replace(run_script, run.encode())
        replace(collect_script, collect.encode())
    return run_script, collect_script


def _resources(options: argparse.Namespace, place: Path) -> Iterator[str]:
    yield f"output={place}/run-{'%j' if options.array is None else '%A_%a'}.out"
    yield f"ntasks={options.ntasks}"
    if options.array is not None:
        yield f"array=1-{options.array}"
    if options.time is not None:
        yield f"time={options.time}"
    if options.lead is not None:
        yield f"signal=B:USR1@{options.lead}"


def filled(template: Path, options: Sequence[str], arguments: Sequence[str]) -> str:
    """Return the text of a template with further options, which override its options, and with its arguments."""
    for option in options:
        if not option.isprintable():  # a line of its own would be a command of the script
            raise OutputError(f"--{option!r}: cannot be in a batch script", "Choose a name without such characters.")
    lines = template.read_text("utf-8").splitlines()
    end = 1 + max(i for i, line in enumerate(lines) if line.startswith("#SBATCH"))
    added = [*(f"#SBATCH --{option}" for option in options), "", f"set -- {shlex.join(arguments)}"]
    if is_asked():
        added.append(f"export {VARIABLE}=1")
    return "\n".join([*lines[:end], *added, *lines[end:], ""])


def sbatch(*words: object) -> str:
    """Submit a script with this Python in PATH; return the id of the job.

    Raises:
        SubmitError: sbatch was not found, or refuses the script.
    """
    environment = dict(os.environ)
    if shutil.which("python") != sys.executable:
        environment["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])
    try:
        done = subprocess.run(
            ["sbatch", "--parsable", *map(str, words)], env=environment, capture_output=True, text=True, check=False
        )
    except FileNotFoundError:
        raise SubmitError(
            "the command sbatch of Slurm was not found",
            "Submit on a login node of the cluster, or use 'sweep run' under mpirun.",
        ) from None
    if done.returncode != 0:
        raise SubmitError(f"sbatch refuses {words[-1]}: {done.stderr.strip()}", "Other options go through --sbatch.")
    return done.stdout.strip().partition(";")[0]  # id;cluster
