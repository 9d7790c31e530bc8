"""How far a sweep is: what is done, who works on it, what has failed and why, and how long it will go on."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hpcinv.batch.forecast import forecast, in_words
from hpcinv.sweep.results import results

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from hpcinv.batch.ledger.ledger import Ledger
    from hpcinv.batch.ledger.record import CaseRecord
    from hpcinv.sweep.plan import SweepPlan

MOST_SHOWN = 5
"""lines of each kind"""


@dataclass(frozen=True)
class Status:
    """Numbers of different cases at one moment.

    Attributes:
        name: of the sweep.
        rows: cases of the sweep, those that are the same counted as often as they are there.
        converged, open: numbers of cases; those that someone works on are in neither.
        running: number of cases by who works on them.
        failed: by diagnosis, the titles of the cases in the order of the sweep.
        seconds: that are left, with as many cases at a time as are running, one at least; ``None`` if nothing tells.
    """

    name: str
    rows: int
    converged: int
    open: int
    running: Mapping[str, int]
    failed: Mapping[str, tuple[str, ...]]
    seconds: float | None

    @property
    def done(self) -> int:
        """Number of finished cases."""
        return self.converged + sum(map(len, self.failed.values()))

    @property
    def total(self) -> int:
        return self.done + self.open + sum(self.running.values())

    @property
    def is_over(self) -> bool:
        return self.done == self.total


def status(plan: SweepPlan, ledger: Ledger, records: Mapping[str, CaseRecord]) -> Status:
    """Where the cases of a sweep stand, of which those in ``records`` are finished; takes and changes nothing."""
    first = {case.key: case for case in reversed(plan.cases)}
    states = ledger.states(first)
    failed: dict[str, list[str]] = {}
    for case in plan.cases:
        record = records.get(case.key)
        if record is not None and not record.converged and first[case.key] is case:
            failed.setdefault(record.status, []).append(case.title)
    running = {key: states[key].holder for key in first if key not in records and states[key].name == "running"}
    left = [case.reuse_group for key, case in first.items() if key not in records]
    seconds = forecast(left, *_experience(plan, records))
    return Status(
        name=plan.sweep.sweep,
        rows=len(plan.cases),
        converged=sum(record.converged for record in records.values()),
        open=len(left) - len(running),
        running=Counter(running.values()),
        failed={why: tuple(titles) for why, titles in failed.items()},
        seconds=None if seconds is None else seconds / max(len(running), 1),
    )


def _experience(plan: SweepPlan, records: Mapping[str, CaseRecord]) -> tuple[dict[str, list[float]], dict[str, int]]:
    """Seconds of finished cases, and their numbers of unknowns, by reuse group."""
    seconds: dict[str, list[float]] = {}
    unknowns: dict[str, int] = {}
    for case in plan.cases:
        if (record := records.get(case.key)) is not None:
            seconds.setdefault(case.reuse_group, []).append(record.seconds)
            if (number := record.statistics.get("mesh", {}).get("unknowns")) is not None:
                unknowns[case.reuse_group] = number
    return seconds, unknowns


def lines(found: Status) -> list[str]:
    """Text on how far a sweep is."""
    doubles = f" ({found.rows:,} rows)" if found.rows != found.total else ""
    text = [f"{found.name}: {found.done:,} of {found.total:,} cases finished{doubles}"]
    text.append(f"  converged: {found.converged:,}")
    if failed := found.done - found.converged:
        text.append(f"  failed: {failed:,}; 'sweep retry --failed' opens them again")
        by_number = sorted(found.failed.items(), key=lambda item: -len(item[1]))
        text += [f"    {len(titles):,} × {why}; the first: {titles[0]}" for why, titles in by_number[:MOST_SHOWN]]
        text += _more(len(by_number), "diagnosis", "diagnoses")
    if found.running:
        text.append(f"  running: {sum(found.running.values()):,}")
        text += [f"    {number:,} by {who}" for who, number in [*found.running.items()][:MOST_SHOWN]]
        text += _more(len(found.running), "process", "processes")
    if found.open:
        text.append(f"  open: {found.open:,}")
    if not found.is_over:
        text.append(f"  time left: {_time_left(found)}")
    return text


def _more(number: int, one: str, many: str) -> list[str]:
    rest = number - MOST_SHOWN
    return [f"    and {rest:,} more {one if rest == 1 else many}"] if rest > 0 else []


def _time_left(found: Status) -> str:
    if found.seconds is None:
        return "not known before the first case is finished"
    at_once = sum(found.running.values())
    how = f"with {at_once} case{'s' if at_once > 1 else ''} at a time" if at_once else "if it ran, one case at a time"
    return f"about {in_words(found.seconds)}, {how}"


def follow(
    plan: SweepPlan,
    ledger: Ledger,
    console: Console,
    *,
    every: float = 2.0,
    sleep: Callable[[float], None] = time.sleep,
) -> Status:
    """Show how far a sweep is until all of it is finished: as a live bar on a terminal, else again whenever it changes.

    Args:
        every: seconds between two looks.
    """
    from rich.live import Live

    records: dict[str, CaseRecord] = {}
    shown: list[str] = []
    with Live(console=console, auto_refresh=False) if console.is_terminal else nullcontext() as live:
        while True:
            records = results(plan, ledger, records)
            found = status(plan, ledger, records)
            if live is not None:
                live.update(_bar(found), refresh=True)
            elif (text := lines(found)) != shown:
                console.print("\n".join(text), markup=False, highlight=False, soft_wrap=True)
                shown = text
            if found.is_over:
                return found
            sleep(every)


def _bar(found: Status) -> RenderableType:
    """The finished share as a bar above the text."""
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.text import Text

    return Group(ProgressBar(total=max(found.total, 1), completed=found.done, width=60), Text("\n".join(lines(found))))
