"""Status of the cases of a batch: how many are finished, running, failed and open, and the time left."""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from hpcinv.studies.batch.time_forecast import duration_text, remaining_seconds

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from hpcinv.studies.batch.ledger.ledger import Ledger
    from hpcinv.studies.batch.outcomes import Outcome

MOST_SHOWN = 5
"""lines of each kind"""
DAMAGED = "record damaged, or a file of the mesh has changed: the next start solves the case again"
_PAUSE = 2.0  # seconds between two looks


class BatchCase(NamedTuple):
    """A case of the ledger; cases of one reuse group take similar times."""

    key: str
    title: str
    reuse_group: str


@dataclass(frozen=True)
class Status:
    """Numbers of distinct cases at one moment.

    Attributes:
        retry: the command that opens failed cases again.
        rows: number of cases, duplicates included.
        certificates: number of converged cases by the verdict of their certificate.
        running: number of cases by the process that works on them.
        failed: titles of the failed cases by diagnosis, in the order of the batch.
        damaged: number of open cases whose record is damaged.
        seconds: time left, with as many cases at a time as are running, at least one; ``None`` if it is not known.
    """

    name: str
    kind: str
    retry: str
    rows: int
    certificates: Mapping[str, int]
    open: int
    running: Mapping[str, int]
    failed: Mapping[str, tuple[str, ...]]
    seconds: float | None
    damaged: int = 0

    @property
    def converged(self) -> int:
        return sum(self.certificates.values())

    @property
    def done(self) -> int:
        return self.converged + sum(map(len, self.failed.values()))

    @property
    def unfinished(self) -> int:
        return self.open + sum(self.running.values())

    @property
    def total(self) -> int:
        return self.done + self.unfinished

    def exit_code(self, *, strict: bool) -> int:
        """Return 3 for failed cases, 6 for a failed certificate, if ``strict`` 7 for one that does not pass, else 0."""
        if self.failed:
            return 3
        if "fail" in self.certificates:
            return 6
        return 7 if strict and self.certificates.keys() & {"warning", "not decided"} else 0


def _failed(cases: Iterable[BatchCase], outcomes: Mapping[str, Outcome]) -> dict[str, tuple[str, ...]]:
    """Return titles of the cases that failed by their diagnosis."""
    failed: dict[str, list[str]] = {}
    for case in cases:
        outcome = outcomes.get(case.key)
        if outcome is not None and not outcome.converged:
            failed.setdefault(outcome.diagnosis, []).append(case.title)
    return {diagnosis: tuple(titles) for diagnosis, titles in failed.items()}


def status(
    name: str,
    cases: Sequence[BatchCase],
    ledger: Ledger,
    outcomes: Mapping[str, Outcome],
    *,
    retry: str,
    kind: str = "cases",
) -> Status:
    """Return the status of cases; claims and changes nothing."""
    distinct = {case.key: case for case in reversed(cases)}
    states = ledger.states(key for key in distinct if key not in outcomes)
    running = Counter(state.holder for state in states.values() if state.name == "running" and not state.waits)
    reuse_groups = {key: case.reuse_group for key, case in distinct.items()}
    seconds = remaining_seconds(reuse_groups, outcomes)
    return Status(
        name=name,
        kind=kind,
        retry=retry,
        rows=len(cases),
        certificates=Counter(outcome.verdict or "not known" for outcome in outcomes.values() if outcome.converged),
        open=len(states) - running.total(),
        running=running,
        failed=_failed([case for case in cases if distinct[case.key] is case], outcomes),
        seconds=None if seconds is None else seconds / max(running.total(), 1),
        damaged=len(ledger.damaged(states)),
    )


def lines(status: Status) -> list[str]:
    """Return a status as lines of text."""
    duplicates = f" ({status.rows:,} rows)" if status.rows != status.total else ""
    text = [f"{status.name}: {status.done:,} of {status.total:,} {status.kind} finished{duplicates}"]
    text.append(f"  converged: {status.converged:,}")
    text += [f"    {number:,} × certificate {verdict}" for verdict, number in sorted(status.certificates.items())]
    if failed := status.done - status.converged:
        text.append(f"  failed: {failed:,}; '{status.retry}' opens them again")
        diagnoses = sorted(status.failed.items(), key=lambda item: -len(item[1]))
        text += [f"    {len(titles):,} × {why}; the first: {titles[0]}" for why, titles in diagnoses[:MOST_SHOWN]]
        text += _more(len(diagnoses), "diagnosis", "diagnoses")
    if status.running:
        text.append(f"  running: {sum(status.running.values()):,}")
        text += [f"    {number:,} by {process}" for process, number in [*status.running.items()][:MOST_SHOWN]]
        text += _more(len(status.running), "process", "processes")
    if status.open:
        text.append(f"  open: {status.open:,}")
        if status.damaged:
            text.append(f"    {status.damaged:,} × {DAMAGED}")
    if status.unfinished:
        text.append(f"  time left: {_time_left(status)}")
    return text


def _more(number: int, singular: str, plural: str) -> list[str]:
    rest = number - MOST_SHOWN
    return [f"    and {rest:,} more {singular if rest == 1 else plural}"] if rest > 0 else []


def _time_left(status: Status) -> str:
    if status.seconds is None:
        return f"not known before the first of the {status.kind} is finished"
    running = sum(status.running.values())
    kind = status.kind.removesuffix("s") if running < 2 else status.kind
    pace = f"with {running} {kind} at a time" if running else f"if it ran, one {kind} at a time"
    return f"about {duration_text(status.seconds)}, {pace}"


def show(look: Callable[[], Status], *, followed: bool) -> None:
    """Print the status that ``look`` returns: once, or, ``followed``, until all cases are finished."""
    if not followed:
        print("\n".join(lines(look())))
        return
    from hpcinv.output.console import Console

    with contextlib.suppress(KeyboardInterrupt):  # the usual way to stop
        follow(look, Console())


def follow(
    look: Callable[[], Status],
    console: Console,
    sleep: Callable[[float], None] = time.sleep,
) -> Status:
    """Print the status until all cases are finished: as a live bar on a terminal, else whenever it changes."""
    from rich.live import Live

    shown: list[str] = []
    with Live(console=console, auto_refresh=False) if console.is_terminal else nullcontext() as live:
        while True:
            status = look()
            if live is not None:
                live.update(_bar(status), refresh=True)
            elif (text := lines(status)) != shown:
                console.print("\n".join(text), markup=False, highlight=False, soft_wrap=True)
                shown = text
            if not status.unfinished:
                return status
            sleep(_PAUSE)


def _bar(status: Status) -> RenderableType:
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.text import Text

    return Group(
        ProgressBar(total=max(status.total, 1), completed=status.done, width=60), Text("\n".join(lines(status)))
    )
