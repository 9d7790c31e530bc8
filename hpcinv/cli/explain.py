"""``hpcinv explain``: table of the parts of a job and their costs."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.base.files.untrusted import add_option
from hpcinv.cli.help import add_command
from hpcinv.job.job import load

if TYPE_CHECKING:
    from hpcinv.cli.form_costs import Explanation, PartCosts
    from hpcinv.job.job import Job


def add_explain(commands: Any) -> None:
    explain = add_command(
        commands,
        "explain",
        "Show the terms of a job's equations, and measure what each costs.",
        examples="hpcinv explain jobs/muscle.yaml",
        page="how-to/choose-a-method.md",
    )
    explain.add_argument("job", type=Path, help="job file (YAML)")
    add_option(explain)
    explain.set_defaults(command=_explain)


def _explain(options: argparse.Namespace) -> int:
    from hpcinv.base.parallel.ranks import failing_together
    from hpcinv.base.parallel.runtime import MPI, on_root

    comm = MPI.COMM_WORLD
    with failing_together(comm):
        job = on_root(comm, lambda: load(options.job))

        from hpcinv.cli.form_costs import explain

        def note(text: str) -> None:
            if comm.rank == 0:
                print(text, file=sys.stderr, flush=True)

        explanation = explain(job, comm, note)
        if comm.rank == 0:
            show(job, explanation)
    return 0


def show(job: Job, explanation: Explanation) -> None:
    from hpcinv.output.console import table_console, table_of_numbers

    console = table_console()
    unknowns = f"{explanation.displacements} displacements" + (
        f", {explanation.pressures} pressures" if explanation.pressures else ""
    )
    console.print(f"{job.job}: {explanation.direction}, {explanation.cells} cells, {unknowns}")
    if explanation.families:
        console.print(f"fibres: {', '.join(explanation.families)}")
    titles = ("part", "integrals", "constants", "fields", "made (CPU)", "residual", "tangent", "of an iteration")
    table = table_of_numbers(*titles)
    for i, row in enumerate((*explanation.rows, explanation.total)):
        table.add_row(*_cells(row, explanation, signed=0 < i < len(explanation.rows)))
    first = "factorization" if explanation.linear_solver == "direct" else "preconditioner"
    for name, seconds in ((first, explanation.factorization), ("solution", explanation.solution)):
        table.add_row(name, "", "", "", "", "", _ms(seconds), f"{seconds / explanation.iteration:.1%}")
    console.print(table)
    console.print(f"one Newton iteration with a new tangent: {_ms(explanation.iteration)}")


def _cells(row: PartCosts, explanation: Explanation, *, signed: bool) -> tuple[str, ...]:
    sign = "+" if signed else ""
    kinds = ", ".join(f"{sign}{n} {kind}" for kind, n in row.integrals.items()) or "-"
    return (
        row.name,
        kinds,
        f"{row.constants:{sign}}",
        f"{row.fields:{sign}}",
        _cost(row.made, f"{row.made:{sign}.1f} s"),
        _cost(row.residual, f"{sign}{_ms(row.residual)}"),
        _cost(row.tangent, f"{sign}{_ms(row.tangent)}"),
        _cost(row.assembly, f"{row.assembly / explanation.iteration:{sign}.1%}"),
    )


def _cost(seconds: float, text: str) -> str:
    """A cost as text: a difference of measurements below 0 is one that they do not resolve."""
    return text if seconds >= 0 else "~0"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.1f} ms"
