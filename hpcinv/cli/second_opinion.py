"""``hpcinv second-opinion``: another program loads the rest shape of a run, and is compared with the given body."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from hpcinv.base.files.untrusted import add_option
from hpcinv.cli.help import add_command
from hpcinv.cli.mesh_input import check_one_process
from hpcinv.errors import OutputError

PROGRAMS = ("calculix", "febio")


def add_second_opinion(commands: Any) -> None:
    parser = add_command(
        commands,
        "second-opinion",
        "Let another program load the rest shape of a finished run, and compare its body with the given one.",
        examples=(
            "hpcinv second-opinion results/part\n"
            "hpcinv second-opinion results/part --command /opt/ccx/bin/ccx_2.21 --limit '30 min'\n"
            "hpcinv second-opinion results/part --with febio --command /opt/febio/bin/febio4"
        ),
        page="how-to/second-opinion.md",
    )
    parser.add_argument("run", type=Path, help="directory of the run")
    parser.add_argument(
        "--with", dest="program", choices=PROGRAMS, default="calculix", help="the program (default: calculix)"
    )
    parser.add_argument("--command", dest="executable", metavar="PATH", help="its command (default: the installed one)")
    parser.add_argument("--limit", default="10 min", help="wall time of the program (default: 10 min)")
    parser.add_argument("--memory", type=float, metavar="GB", help="memory of the program (default: the machine's)")
    add_option(parser)
    parser.set_defaults(command=_second_opinion)


def _second_opinion(options: argparse.Namespace) -> int:
    from hpcinv.base.files.directory_lock import check_unlocked
    from hpcinv.studies.second_opinion.opinion import FOLDER, second_opinion

    check_one_process("second-opinion")
    check_unlocked(options.run)
    if options.memory is not None and not options.memory > 0:
        raise OutputError(f"--memory {options.memory:g}: must be above 0")
    memory = None if options.memory is None else round(options.memory * 1e9)
    opinion = second_opinion(options.run, options.executable, _seconds(options.limit), memory, options.program)
    print("\n".join(opinion.lines()))
    print(f"{opinion.verdict.value}; a line of the certificate; deck and output in {options.run / FOLDER}")
    return 0


def _seconds(text: str) -> float:
    from hpcinv.base.quantity.units import as_float, parse_quantity

    try:
        value, dimension = parse_quantity(text)
    except ValueError as error:
        raise OutputError(f"--limit {text}: {error}") from None
    if dimension.unit != "s" or not value > 0:
        raise OutputError(f"--limit {text}: must be a time above 0, such as '10 min'")
    return as_float(value)
