"""What the names of a case's files tell of it; `ledger` says what they mean together."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from hpcinv.batch.ledger.store import records_in, told

_NAME = re.compile(
    r"\.?\w+\.(?P<kind>claim|crashed|released|record|reopened)-(?P<round>\d+)(-(?P<claim>\d+))?(\.json)?(?P<partial>\.\w+\.partial)?"
)


@dataclass(frozen=True)
class History:
    """The latest round of a case.

    Attributes:
        round: its number.
        finished: whether it has a record.
        claims: how many there were, and so the number of the last.
        released: which of them were given back.
        crashed: which of them ended with a crash of their process that its supervisor has seen.
        passing: names of all files, of any round, that mean nothing once there is a record.
    """

    round: int = 1
    finished: bool = False
    claims: int = 0
    released: frozenset[int] = frozenset()
    crashed: frozenset[int] = frozenset()
    passing: tuple[str, ...] = ()

    @classmethod
    def told_by(cls, names: Iterable[str]) -> History:
        rounds, records = [1], set[int]()
        claims, released, crashed = dict[int, set[int]](), dict[int, set[int]](), dict[int, set[int]]()
        passing = []
        for name in names:
            if (found := _NAME.fullmatch(name)) is None:
                continue
            kind, number, claim = found["kind"], int(found["round"]), int(found["claim"] or 0)
            if found["partial"] or kind in ("claim", "crashed", "released"):
                passing.append(name)
            if found["partial"]:
                continue
            match kind:
                case "reopened":
                    rounds.append(number)
                case "record":
                    records.add(number)
                case "claim":
                    claims.setdefault(number, set()).add(claim)
                case "crashed":
                    crashed.setdefault(number, set()).add(claim)
                case _:
                    released.setdefault(number, set()).add(claim)
        latest = max(rounds)
        return cls(
            round=latest,
            finished=latest in records,
            claims=max(claims.get(latest, ()), default=0),
            released=frozenset(released.get(latest, ())),
            crashed=frozenset(crashed.get(latest, ())),
            passing=tuple(passing),
        )

    @property
    def is_claimed(self) -> bool:
        """Whether there is a last claim that was not given back; its holder may be dead."""
        return self.claims > 0 and self.claims not in self.released

    @property
    def unreleased(self) -> int:
        """How many claims ended, without a record, by the end of their process; the last may not have ended yet."""
        return self.claims - len(self.released)


class Histories:
    """The histories of the cases in a store, as its files tell them at the moment."""

    def __init__(self, store: Path) -> None:
        self._directory = records_in(store)

    def file(self, key: str, name: str) -> Path:
        return self._directory / key[:2] / f"{key}.{name}"

    def of(self, key: str) -> History:
        return self.of_all([key])[key]

    def of_all(self, keys: Iterable[str]) -> dict[str, History]:
        """By key, with one scan for all that have the first two digits in common."""
        keys = list(keys)
        names: dict[str, list[str]] = {key: [] for key in keys}
        for prefix in {key[:2] for key in keys}:
            for name in _names_in(self._directory / prefix):
                if (key := name.lstrip(".").partition(".")[0]) in names:
                    names[key].append(name)
        return {key: History.told_by(found) for key, found in names.items()}


def _names_in(directory: Path) -> list[str]:
    with told(directory):
        try:
            return [entry.name for entry in os.scandir(directory)]
        except FileNotFoundError:
            return []
