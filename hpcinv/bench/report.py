"""What a section of the benchmark has found: a table to print, and all figures as data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rich.table import Table

from hpcinv.output.console import Console


@dataclass(frozen=True)
class Findings:
    """A table with its title, notes below it, the figures (s, bytes) for machines, and further tables."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()
    data: Mapping[str, Any] = field(default_factory=dict)
    then: Sequence[Findings] = ()


def show(found: Findings) -> None:
    """Print it; plain where it goes to a file or a pipe."""
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console.width = 160  # a file has no width of its own
    console.print(found.title, style="bold")
    table = Table(box=None, pad_edge=False, header_style="")
    for i, title in enumerate(found.columns):
        table.add_column(title, justify="right" if i else "left", no_wrap=True)
    for row in found.rows:
        table.add_row(*row)
    console.print(table)
    for note in found.notes:
        console.print(note)
    console.print()
    for further in found.then:
        show(further)


def ratio(name: str, value: float, least: float, digits: int = 1) -> str:
    """A ratio beside what it must be at least."""
    return f"{name}: {value:.{digits}f} times (at least {least:g}: {'met' if value >= least else 'MISSED'})"
