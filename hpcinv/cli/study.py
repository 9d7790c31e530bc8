"""``hpcinv study``: run, status."""

import argparse
from pathlib import Path
from typing import Any

from hpcinv.base.files.untrusted import add_option
from hpcinv.cli.help import add_command
from hpcinv.cli.options import add_ranks
from hpcinv.studies.study.study_plan import load_study


def add_study(commands: Any) -> None:
    study = add_command(
        commands,
        "study",
        "Compare accuracy and time of many runs of a job (study FILE is short for study run FILE).",
        examples=(
            "mpirun -n 2 hpcinv study jobs/study-sphere.yaml\nhpcinv study status jobs/study-sphere.yaml --follow"
        ),
        page="how-to/study.md",
    )
    actions = study.add_subparsers(required=True, metavar="command")
    run = add_command(
        actions,
        "run",
        "Solve those runs of a study that are not done yet (under mpirun; several may run at once).",
        examples="mpirun -n 2 hpcinv study run jobs/study-sphere.yaml --output results/sphere",
        page="how-to/study.md",
    )
    run.add_argument("--retry-failed", action="store_true", help="try runs that have failed before once more")
    add_ranks(run)
    run.set_defaults(command=_run)
    status = add_command(
        actions,
        "status",
        "Show how many executions of a study are finished, and the time left.",
        examples="hpcinv study status jobs/study-sphere.yaml --follow",
        page="how-to/study.md",
    )
    status.add_argument("--follow", action="store_true", help="repeat it until all executions are finished")
    status.add_argument("--ranks", type=int, help="number of ranks (default: as in the last start)")
    status.set_defaults(command=_status)
    for parser in (run, status):
        parser.add_argument("study", type=Path, help="study file (YAML)")
        parser.add_argument(
            "--output", type=Path, metavar="DIR", help="directory of the results (default: results/STUDY)"
        )
        add_option(parser)


def _run(options: argparse.Namespace) -> int:
    from hpcinv.base.parallel.launch import launched

    with launched(options.ranks) as (comm, stop):
        from hpcinv.base.parallel.runtime import on_root
        from hpcinv.studies.study.study_run import run_study

        plan = on_root(comm, lambda: load_study(options.study))
        run_study(plan, comm, directory=options.output or plan.results, retry_failed=options.retry_failed, stop=stop)
    return 0


def _status(options: argparse.Namespace) -> int:
    from hpcinv.studies.batch.status import show
    from hpcinv.studies.study.executions import executions_in

    plan = load_study(options.study)
    executions = executions_in(plan, options.output or plan.results, options.ranks)
    show(executions.status, followed=options.follow)
    return 0
