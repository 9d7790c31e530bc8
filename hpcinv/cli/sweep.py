"""``hpcinv sweep``: plan, run, status, retry, table, statistics, indices, plot, submit."""

import argparse
from pathlib import Path
from typing import Any

from hpcinv.base.files.untrusted import add_option
from hpcinv.cli.help import add_command
from hpcinv.cli.options import add_ranks, positive
from hpcinv.cli.sweep_results import add_results
from hpcinv.cli.sweep_submit import add_submit
from hpcinv.errors import Interrupted, OutputError
from hpcinv.studies.batch.ledger.holder import BEAT
from hpcinv.studies.batch.ledger.liveness import LEASE
from hpcinv.studies.batch.status import lines
from hpcinv.studies.sweep.kept_plan import keep_plan
from hpcinv.studies.sweep.results import outcomes, series_line, status_of
from hpcinv.studies.sweep.sweep_batch import open_damaged, sweep_batch
from hpcinv.studies.sweep.sweep_plan import SweepPlan, load_sweep, read_sweep


def add_sweep(commands: Any) -> None:
    sweep = add_command(
        commands,
        "sweep",
        "Solve many cases of a job: over laws, parameters, loads, meshes.",
        examples=(
            "hpcinv sweep plan jobs/sweep-uncertain-block.yaml\n"
            "mpirun -n 4 hpcinv sweep run jobs/sweep-uncertain-block.yaml\n"
            "hpcinv sweep table jobs/sweep-uncertain-block.yaml"
        ),
        page="how-to/sweep.md",
    )
    actions = sweep.add_subparsers(required=True, metavar="command")

    def action(name: str, command: Any, sentence: str, example: str = "") -> argparse.ArgumentParser:
        example = f"hpcinv sweep {name} sweep.yaml {example}".strip()
        page = "how-to/slurm.md" if name == "submit" else "how-to/sweep.md"
        parser = add_command(actions, name, sentence, examples=example, page=page)
        parser.add_argument("sweep", type=Path, help="sweep file (YAML)")
        add_option(parser)
        parser.set_defaults(command=command)
        return parser

    plan = action("plan", _plan, "Show the number and size of the cases, and a forecast of their time.", "--groups 4")
    plan.add_argument("--groups", type=positive, default=1, metavar="N", help="groups of ranks for the forecast")

    run = action(
        "run", _run, "Solve those cases that are not done yet (under mpirun; several may run at once).", "--first 100"
    )
    run.add_argument("--ranks-per-case", type=positive, default=1, metavar="K", help="ranks that solve a case together")
    add_ranks(run)
    run.add_argument(
        "--shard",
        type=_shard,
        default=(1, 1),
        metavar="I/N",
        help="begin with this share of the cases, then go on with the others",
    )
    run.add_argument("--first", type=positive, metavar="N", help="only the first N cases: of a sample, a smaller one")
    run.add_argument(
        "--lease", type=_lease, default=LEASE, metavar="S", help="seconds after which a silent machine counts as lost"
    )
    run.add_argument(
        "--no-isolation",
        action="store_false",
        dest="isolation",
        help="solve cases in the ranks of the launcher themselves: a case that crashes ends them all",
    )
    run.add_argument(
        "--strict", action="store_true", help="end with exit code 7 if certificates have warnings or are not decided"
    )

    retry = action("retry", _retry, "Mark cases as open, so that the next start solves them again.", "--failed")
    retry.add_argument("--failed", action="store_true", required=True, help="all cases that have failed")

    teach = action(
        "teach", _teach, "Learn the start of new jobs (solver.start) from the solutions of the cases.", "--output start"
    )
    teach.add_argument("--output", type=Path, metavar="DIR", help="directory (default: results/SWEEP-start)")
    teach.add_argument("--overwrite", action="store_true", help="replace a start that is there")
    add_ranks(teach)

    add_results(action)
    add_submit(action)


def _lease(text: str) -> float:
    if (seconds := float(text)) < 3 * BEAT:
        raise argparse.ArgumentTypeError(f"must be {3 * BEAT:g} or more: a heartbeat is written every {BEAT:g} s")
    return seconds


def _shard(text: str) -> tuple[int, int]:
    number, _, count = text.partition("/")
    if not (number.isdigit() and count.isdigit() and 1 <= int(number) <= int(count)):
        raise argparse.ArgumentTypeError(f"'{text}' is not a share such as 2/8")
    return int(number), int(count)


def _plan(options: argparse.Namespace) -> int:
    plan = load_sweep(options.sweep)

    from hpcinv.studies.sweep.outlook import outlook

    for line in outlook(plan, plan.ledger, options.groups):
        print(line)
    return 0


def _run(options: argparse.Namespace) -> int:
    from hpcinv.base.parallel.launch import launched

    with launched(options.ranks, stack=False) as (world, stop):
        from hpcinv.base.parallel.ranks import on_root
        from hpcinv.studies.batch.conduct import conduct

        def check() -> SweepPlan:
            file = read_sweep(options.sweep)
            groups = f"{world.size} rank{'s' if world.size > 1 else ''}, {options.ranks_per_case} per case"
            count = min(file.case_count, options.first or file.case_count)
            print(f"{file.sweep.sweep}: {count:,} cases, {groups}; store {file.store}", flush=True)
            return file.plan(options.first)

        plan = on_root(world, check)

        def begin() -> bool:
            keep_plan(plan)
            if damaged := open_damaged(plan):
                print(
                    f"  {damaged:,} × record damaged, or a file of the mesh has changed: the case is solved again",
                    flush=True,
                )
            states = plan.ledger.states(plan.cases.keys)
            return any(state.name != "finished" for state in states.values())

        def end() -> tuple[int, int]:
            ledger = plan.ledger
            finished = outcomes(plan, ledger)
            status = status_of(plan, ledger, finished)
            print("\n".join([*lines(status), *series_line(finished)]), flush=True)
            return status.exit_code(strict=options.strict), status.unfinished

        is_unfinished = on_root(world, begin)  # else no process has to import PETSc
        interrupted = False
        try:
            if is_unfinished:
                conduct(
                    sweep_batch(plan),
                    world,
                    ranks_per_case=options.ranks_per_case,
                    share=options.shard,
                    lease=options.lease,
                    isolated=options.isolation,
                    note=lambda text: print(text, flush=True),
                    stop=stop,
                )
        except Interrupted:
            interrupted = True
        code, left = on_root(world, end)
        if interrupted and left:
            raise Interrupted(f"stopped by a signal, {left} cases left", "The same command goes on.")
    return code


def _teach(options: argparse.Namespace) -> int:
    from hpcinv.base.parallel.launch import launched

    with launched(options.ranks) as (world, _):
        from hpcinv.base.parallel.ranks import on_root
        from hpcinv.studies.sweep.training import train

        plan = on_root(world, lambda: load_sweep(options.sweep))
        path = options.output or Path("results") / f"{plan.sweep.sweep}-start"

        def check() -> None:
            if path.exists() and not (options.overwrite and (path / "start.json").is_file()):
                raise OutputError(f"{path}: exists", "Choose another --output, or replace a start by --overwrite.")

        on_root(world, check)
        training = train(plan, path, world)
        if world.rank == 0:
            print("\n".join([*training.lines(), f"{path}; in a job: 'solver: {{start: {path}}}'"]))
    return 0


def _retry(options: argparse.Namespace) -> int:
    plan = load_sweep(options.sweep)
    ledger = plan.ledger
    opened = len(ledger.retry(*dict.fromkeys(plan.cases.keys)))
    print(f"{opened} failed case{'s are' if opened != 1 else ' is'} open again")
    return 0
