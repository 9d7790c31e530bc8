"""History of a case as the names of its files have it; `ledger` defines their meaning."""

import os
import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from hpcinv.studies.batch.ledger.store import RECORDS, as_output_error

_NAME = re.compile(
    r"\.?\w+\.(?P<kind>claim|crashed|released|record|reopened)-(?P<round>\d+)(-(?P<claim>\d+))?(\.json)?(?P<partial>\.\w+\.partial)?"
)


@dataclass(frozen=True)
class History:
    """The latest round of a case.

    Attributes:
        claims: number of claims, which is the number of the last one.
        crashed: numbers of the claims whose process crashed, as its supervisor noted.
        temporary: names of all files, of any round, that have no meaning once there is a record.
    """

    round: int = 1
    finished: bool = False
    claims: int = 0
    released: frozenset[int] = frozenset()
    crashed: frozenset[int] = frozenset()
    temporary: tuple[str, ...] = ()

    @classmethod
    def from_names(cls, names: Iterable[str]) -> Self:
        """Return the history that the names of the files of a case give."""
        files = [match for match in map(_NAME.fullmatch, names) if match is not None]
        numbers = defaultdict[tuple[str, int], set[int]](set)  # of claims, by kind of file and round
        for file in files:
            if not file["partial"]:
                numbers[file["kind"], int(file["round"])].add(int(file["claim"] or 0))
        latest = max((number for kind, number in numbers if kind == "reopened"), default=1)
        return cls(
            round=latest,
            finished=("record", latest) in numbers,
            claims=max(numbers["claim", latest], default=0),
            released=frozenset(numbers["released", latest]),
            crashed=frozenset(numbers["crashed", latest]),
            temporary=tuple(file[0] for file in files if file["partial"] or file["claim"]),
        )

    @property
    def is_claimed(self) -> bool:
        """True if the last claim was not released; its holder may be dead."""
        return self.claims > 0 and self.claims not in self.released

    @property
    def unreleased(self) -> int:
        """Number of claims that were not released; the last of them may still be held."""
        return self.claims - len(self.released)


class Histories:
    """Histories of the cases in a store, read from its files at each call."""

    def __init__(self, store: Path) -> None:
        self._directory = store / RECORDS

    def file(self, key: str, name: str) -> Path:
        return self._directory / key[:2] / f"{key}.{name}"

    def history(self, key: str) -> History:
        return self.histories([key])[key]

    def histories(self, keys: Iterable[str]) -> dict[str, History]:
        """Return histories by key, with one directory scan for all keys with the same first two digits."""
        keys = list(keys)
        names: dict[str, list[str]] = {key: [] for key in keys}
        for prefix in {key[:2] for key in keys}:
            for name in _names_in(self._directory / prefix):
                if (key := name.lstrip(".").partition(".")[0]) in names:
                    names[key].append(name)
        return {key: History.from_names(entries) for key, entries in names.items()}


def _names_in(directory: Path) -> list[str]:
    with as_output_error(directory):
        try:
            return [entry.name for entry in os.scandir(directory)]
        except FileNotFoundError:
            return []
