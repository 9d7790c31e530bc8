"""``hpcinv report``: one HTML file with the result of a run, to look at in a browser."""

import argparse
from pathlib import Path
from typing import Any

from hpcinv.cli.help import add_command
from hpcinv.cli.mesh import on_one_process
from hpcinv.errors import OutputError
from hpcinv.files.untrusted import add_option


def add_report(commands: Any) -> None:
    report = add_command(
        commands,
        "report",
        "Write one HTML file with the result of a run, to look at in a browser.",
        examples="hpcinv report results/thick-sphere\nhpcinv report results/thick-sphere --output sphere.html",
        page="how-to/report.md",
    )
    report.add_argument("input", type=Path, help="directory of a run")
    report.add_argument("--output", type=Path, metavar="FILE", help="the page (default: report.html in the directory)")
    add_option(report)
    report.set_defaults(command=_report)


def _report(options: argparse.Namespace) -> int:
    given: Path = options.input
    if not given.exists():
        raise OutputError(f"{given}: no such directory", "Give the directory that 'run' printed at its beginning.")
    on_one_process("report")
    print(_of_run(given, options.output))
    return 0


def _of_run(directory: Path, output: Path | None) -> Path:
    from hpcinv.output.run_directory import RunDirectory
    from hpcinv.reports.of_run import write_run_report

    return write_run_report(directory, RunDirectory(directory).summary(), output)
