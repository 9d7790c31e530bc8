"""Histories of cases, as the log of a store has them; `ledger` defines their meaning."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from hpcinv.base.parallel.processes import Identity
from hpcinv.studies.batch.ledger.store import as_output_error

type Mark = tuple[str, int, int]
"""key, round and number of a claim"""


class History(NamedTuple):
    """The latest round of a case.

    Attributes:
        holders: tokens of the processes that have claimed it, in this order; "" if it is not known.
        released: numbers, from 1, of the claims that were released, or whose process never began the case.
        crashed: number and end of each claim whose process crashed, as its supervisor noted.
    """

    round: int = 1
    holders: tuple[str, ...] = ()
    released: frozenset[int] = frozenset()
    crashed: tuple[tuple[int, str], ...] = ()

    @property
    def claims(self) -> int:
        return len(self.holders)

    @property
    def is_claimed(self) -> bool:
        """True if the last claim was not released; its holder may be dead."""
        return self.claims > 0 and self.claims not in self.released

    @property
    def unreleased(self) -> int:
        """Number of claims that were not released; the last of them may still be held."""
        return self.claims - len(self.released)


class Histories:
    """Histories of all cases of a store, and the holders of their claims.

    Attributes:
        blocks: for each holder the claims of its last entry, in the order in which it works on them.
        supervised: holders with a supervisor that notes their crashes.
    """

    def __init__(self) -> None:
        self._histories: dict[str, History] = {}
        self._first: dict[str, History] = {}  # of cases that a holder has claimed first, which share it
        self._counted: dict[tuple[str, int], int] = {}  # the claim whose record counted, of rounds that are over
        self.identities: dict[str, Identity] = {}
        self.blocks: dict[str, list[Mark]] = {}
        self.supervised: set[str] = set()

    def of(self, key: str) -> History:
        return self._histories.get(key, _NEW)

    def is_last(self, mark: Mark) -> bool:
        """Return whether a claim is the last one of the latest round, and was not released."""
        key, number, claim = mark
        history = self.of(key)
        return (history.round, history.claims) == (number, claim) and history.is_claimed

    def counts(self, mark: Mark) -> bool:
        """Return whether the record of a claim, which has been written, counts, or has counted, in its round."""
        key, number, claim = mark
        return self.is_last(mark) or self._counted.get((key, number)) == claim

    def begin(self, key: str, history: History) -> None:
        """Set what is known of a case before the log."""
        self._histories[key] = history

    def add(self, entry: dict[str, Any]) -> None:
        """Add an entry of the log; what does not follow from the entries before is left out."""
        for key, number, counted in entry.get("reopened", ()):
            if number == self.of(key).round + 1:
                self._histories[key] = History(number)
                self._counted[key, number - 1] = counted
        for key, number, claim in entry.get("released", ()):
            history = self.of(key)
            if history.round == number:
                self._histories[key] = history._replace(released=history.released | {claim})
        for key, number, claim in entry.get("crashed", ()):
            history = self.of(key)
            if history.round == number:
                self._histories[key] = history._replace(crashed=(*history.crashed, (claim, str(entry.get("how")))))
        if "claims" in entry:
            with contextlib.suppress(ValueError):
                self._add_claims(entry, Identity.from_json(entry.get("holder")))

    def _add_claims(self, entry: dict[str, Any], holder: Identity) -> None:
        token = holder.token
        self.identities[token] = holder
        if entry.get("supervised") is True:
            self.supervised.add(token)
        self.blocks[token] = [(key, number, claim) for key, number, claim in entry["claims"]]
        first = self._first.setdefault(token, History(1, (token,)))
        for key, number, claim in self.blocks[token]:
            history = self.of(key)
            if (history.round, history.claims + 1) == (number, claim):
                self._histories[key] = first if history == _NEW else history._replace(holders=(*history.holders, token))


_NEW = History()
_FILE = re.compile(r"(?P<key>\w+)\.(?P<kind>claim|record|reopened)-(?P<round>\d+)(-(?P<claim>\d+))?(\.json)?")


def earlier_histories(ledger: Path) -> Iterator[tuple[str, History, bool]]:
    """Yield key, history, and whether it is finished, of the cases of a ledger of one file for each case.

    Stores of format 1 have such ledgers, in directories of two digits. Claims there are of processes that have ended.
    """
    with as_output_error(ledger):
        directories = [Path(entry.path) for entry in _entries(ledger) if len(entry.name) == 2]
    for directory in directories:
        cases: dict[str, tuple[int, set[int], int]] = {}
        with as_output_error(directory):
            names = [entry.name for entry in _entries(directory)]
        for match in filter(None, map(_FILE.fullmatch, names)):
            key, kind, number, claim = match["key"], match["kind"], int(match["round"]), int(match["claim"] or 0)
            latest, records, claims = cases.get(key, (1, set[int](), 0))
            if kind == "record":
                records.add(number)
            elif number > latest:
                latest, claims = number, claim
            elif number == latest:
                claims = max(claims, claim)
            cases[key] = latest, records, claims
        for key, (latest, records, claims) in cases.items():
            yield key, History(latest, ("",) * claims, frozenset(range(1, claims + 1))), latest in records


def _entries(directory: Path) -> list[os.DirEntry[str]]:
    try:
        return list(os.scandir(directory))
    except (FileNotFoundError, NotADirectoryError):
        return []
