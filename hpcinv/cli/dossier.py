"""``hpcinv dossier``: the credibility dossier of a run, and the context file that it asks for."""

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hpcinv.base.files.untrusted import add_option
from hpcinv.base.reading.door import admitted
from hpcinv.cli.help import add_command
from hpcinv.cli.mesh_input import check_one_process
from hpcinv.errors import OutputError


def add_dossier(commands: Any) -> None:
    dossier = add_command(
        commands,
        "dossier",
        "Write the credibility dossier of a run (ASME V&V 40, FDA guidance) as one HTML file.",
        examples="hpcinv dossier results/job --ask context.yaml\nhpcinv dossier results/job --context context.yaml",
        page="how-to/dossier.md",
    )
    dossier.add_argument("run", type=Path, help="directory of a finished run, or of an identification")
    given = dossier.add_mutually_exclusive_group()
    given.add_argument("--context", type=Path, metavar="FILE", help="texts of the applicant (YAML)")
    given.add_argument("--ask", type=Path, metavar="FILE", help="write a context file to be filled, and no dossier")
    dossier.add_argument("--output", type=Path, metavar="FILE", help="the page (default: dossier.html in the run)")
    add_option(dossier)
    dossier.set_defaults(command=_dossier)


def _dossier(options: argparse.Namespace) -> int:
    from hpcinv.base.files.atomic import write_output
    from hpcinv.output.run_directory import RunDirectory
    from hpcinv.pages.reports.page import write_page
    from hpcinv.studies.dossier.content import NAME, dossier_page, properties
    from hpcinv.studies.dossier.context import DossierContext, read_context, template

    check_one_process("dossier")
    directory, figures = _run_of(options.run)
    summary = RunDirectory(directory).summary() if directory.is_dir() else None
    if summary is None:
        raise OutputError(
            f"{directory}: has no summary of a run", "Give the directory that 'run' or 'identify' printed."
        )
    if options.ask is not None:
        if options.ask.exists():
            raise OutputError(f"--ask {options.ask}: exists already", "Name another file, or give it as --context.")
        write_output(options.ask, template(properties(summary)).encode(), "Does the directory exist?")
        print(options.ask)
        return 0
    context = DossierContext() if options.context is None else read_context(options.context)
    page = options.output or directory / NAME
    write_page(page, dossier_page(directory, summary, context, figures))
    print(page)
    return 0


def _run_of(directory: Path) -> tuple[Path, Mapping[str, Any] | None]:
    """Return the directory of a run, and the figures of the identification whose estimate it is, if there are any."""
    from hpcinv.studies.identification.identification_page import FIGURES

    source = directory / FIGURES
    if not source.is_file():
        return directory, None
    try:
        return directory / "run", json.loads(admitted(source).read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise OutputError(
            f"{source}: cannot be read ({type(error).__name__})",
            "Run 'hpcinv identify' again: finished evaluations are used again.",
        ) from None
