"""``hpcinv report``: one HTML file with the result of a run, an identification, a sweep or a study."""

import argparse
from pathlib import Path
from typing import Any

from hpcinv.base.files.untrusted import add_option
from hpcinv.cli.help import add_command
from hpcinv.cli.mesh_input import JOBS, check_one_process
from hpcinv.errors import OutputError
from hpcinv.job.yaml_reader import read_yaml


def add_report(commands: Any) -> None:
    report = add_command(
        commands,
        "report",
        "Write one HTML file with the result of a run, an identification, a sweep or a study.",
        examples="hpcinv report results/thick-sphere\nhpcinv report sweep.yaml --cases\nhpcinv report study.yaml",
        page="how-to/report.md",
    )
    report.add_argument(
        "input", type=Path, help="directory of a run or an identification, or file of a sweep or a study"
    )
    report.add_argument(
        "--output", type=Path, metavar="FILE", help="the page (default: report.html in the directory of the results)"
    )
    report.add_argument("--cases", action="store_true", help="of a sweep: write a report of each case, too")
    report.add_argument(
        "--results", type=Path, metavar="DIR", help="of a study: directory of its results (default: results/STUDY)"
    )
    add_option(report)
    report.set_defaults(command=_report)


def _check_options(options: argparse.Namespace, *, is_sweep: bool, is_study: bool) -> None:
    given: Path = options.input
    if given.is_file() and not (is_sweep or is_study):
        raise OutputError(f"{given}: is neither a sweep nor a study", "Of a job, give the directory of its run.")
    if options.cases and not is_sweep:
        raise OutputError(f"{given}: --cases is for sweeps")
    if options.results and not is_study:
        raise OutputError(f"{given}: --results is for studies")


def _report(options: argparse.Namespace) -> int:
    given: Path = options.input
    if not given.exists():
        raise OutputError(f"{given}: no such file or directory", "Give the directory of a run, a sweep or a study.")
    check_one_process("report")
    content = read_yaml(given) if given.suffix in JOBS else {}
    is_sweep, is_study = "axes" in content, "series" in content
    _check_options(options, is_sweep=is_sweep, is_study=is_study)
    if is_sweep:
        print(_sweep_report(given, options.output, each=options.cases))
    elif is_study:
        print(_study_report(given, options.output, options.results))
    elif (given / "identification.json").is_file():
        print(_identification_report(given, options.output))
    else:
        print(_run_report(given, options.output))
    return 0


def _identification_report(directory: Path, output: Path | None) -> Path:
    from hpcinv.studies.identification.identification_page import write_identification_report

    return write_identification_report(directory, output)


def _run_report(directory: Path, output: Path | None) -> Path:
    from hpcinv.output.run_directory import RunDirectory
    from hpcinv.pages.reports.run_page import write_run_report

    return write_run_report(directory, RunDirectory(directory).summary(), output)


def _sweep_report(path: Path, output: Path | None, *, each: bool) -> Path:
    from hpcinv.studies.sweep.sweep_page import write_sweep_report
    from hpcinv.studies.sweep.sweep_plan import load_sweep

    plan = load_sweep(path)
    page = output or plan.results / "report.html"
    return write_sweep_report(plan, plan.ledger, page, each=each)


def _study_report(path: Path, output: Path | None, results: Path | None) -> Path:
    from hpcinv.studies.study.executions import executions_in
    from hpcinv.studies.study.study_page import write_study_report
    from hpcinv.studies.study.study_plan import load_study

    plan = load_study(path)
    directory = results or plan.results
    if not directory.is_dir():
        raise OutputError(f"{directory}: no such directory", f"Run it first: python -m hpcinv study {path}")
    return write_study_report(executions_in(plan, directory), output or directory / "report.html")
