"""Cases of a sweep: what was found for each is in columns, and a case is made when it is asked for."""

from __future__ import annotations

import sys
from array import array
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, overload

from hpcinv.studies.batch.axes import sections_first
from hpcinv.studies.batch.points import CombinedPoints
from hpcinv.studies.batch.specification import texts_of
from hpcinv.studies.sweep.sweep_spec import Sweep

_DIGITS = 20  # of a key


@dataclass(frozen=True)
class Case:
    """One job of a sweep.

    Attributes:
        key: hash of everything that its results depend on, the same in every sweep (20 hex digits).
        reuse_group: key of the cases that share mesh, equations and the pattern of the factorization.
        numbers: the numbers in which cases of one reuse group differ (SI).
        parameters: values by key as in the file, sampled ones in SI, and labels of branches by the name of their axis.
        settings: values by key that are set in the job of the sweep.
        home: directory of the file of its mesh.
    """

    number: int
    key: str
    reuse_group: str
    numbers: tuple[float, ...]
    parameters: Mapping[str, Any]
    settings: Mapping[str, Any]
    home: Path

    @property
    def title(self) -> str:
        return title_of(self.number, self.parameters)


def _as_text(column: array[Any]) -> str:
    """Return the bytes of a column, the first of a number its lowest, in base 64."""
    if sys.byteorder == "big":
        column = column[:]
        column.byteswap()
    return b64encode(column.tobytes()).decode()


def _of_text(kind: str, text: str) -> array[Any]:
    column = array(kind)
    column.frombytes(b64decode(text, validate=True))
    if sys.byteorder == "big":
        column.byteswap()
    return column


class Labels[T]:
    """Column of labels with many equal entries."""

    def __init__(self) -> None:
        self._numbers: dict[T, int] = {}
        self.distinct: list[T] = []
        self.column = array("q")

    def append(self, label: T) -> None:
        number = self._numbers.setdefault(label, len(self.distinct))
        if number == len(self.distinct):
            self.distinct.append(label)
        self.column.append(number)

    def __getitem__(self, place: int) -> T:
        return self.distinct[self.column[place]]

    def as_data(self) -> list[Any]:
        """Return the column as JSON data."""
        return [[*map(str, self.distinct)], _as_text(self.column)]

    @classmethod
    def of_data(cls, label: Callable[[str], T], data: Sequence[Any]) -> Self:
        """Return the column that `as_data` has returned; ``label`` makes a label of its text."""
        labels = cls()
        labels.distinct, labels.column = [*map(label, data[0])], _of_text("q", data[1])
        labels._numbers = {label: number for number, label in enumerate(labels.distinct)}
        return labels


type Found = tuple[str, str, tuple[float, ...], Path]
"""key, reuse group, numbers and home of a case, as `Case` has them"""


class Cases(Sequence[Case]):
    """The cases of a sweep in order; a slice is another view of the same columns.

    Attributes:
        points: of the axes, also of the cases that are not added yet.
        places: of these cases in the columns, which are their numbers.
    """

    def __init__(self, sweep: Sweep) -> None:
        self.points = CombinedPoints(sweep.axes)
        self.places: Sequence[int] = range(0)
        self._common = sections_first(sweep.set)
        self._keys, self._reuse_groups, self._homes = bytearray(), Labels[str](), Labels[Path]()
        self._numbers, self._ends = array("d"), array("q", [0])

    def append(self, key: str, reuse_group: str, numbers: Sequence[float], home: Path) -> None:
        """Add the next case."""
        self._keys += key.encode()
        self._reuse_groups.append(reuse_group)
        self._homes.append(home)
        self._numbers.extend(numbers)
        self._ends.append(len(self._numbers))
        self.places = range(len(self._homes.column))

    def found(self, place: int) -> Found:
        """Return what was found for a case."""
        return self._key(place), self._reuse_groups[place], self._numbers_of(place), self._homes[place]

    def as_data(self) -> dict[str, Any]:
        """Return what was found for all cases as JSON data."""
        return {
            "keys": self._keys.decode(),
            "reuse_groups": self._reuse_groups.as_data(),
            "homes": self._homes.as_data(),
            "numbers": _as_text(self._numbers),
            "ends": _as_text(self._ends),
        }

    @classmethod
    def of_data(cls, sweep: Sweep, data: Mapping[str, Any]) -> Self:
        """Return the cases of a sweep with what `as_data` has returned."""
        cases = cls(sweep)
        cases._keys += data["keys"].encode()
        cases._reuse_groups = Labels.of_data(str, data["reuse_groups"])
        cases._homes = Labels.of_data(Path, data["homes"])
        cases._numbers, cases._ends = _of_text("d", data["numbers"]), _of_text("q", data["ends"])
        cases.places = range(len(cases._homes.column))
        return cases

    def settings(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return all settings of a case, for the settings that its axes give."""
        return {key: value for key, value in self._common.items() if key not in given} | sections_first(given)

    @property
    def keys(self) -> Iterator[str]:
        """Keys of the cases, in their order; equal cases have equal keys."""
        return map(self._key, self.places)

    @property
    def reuse_groups(self) -> Iterator[str]:
        """Reuse groups of the cases, in their order."""
        return map(self._reuse_groups.__getitem__, self.places)

    @property
    def numbers(self) -> Iterator[tuple[float, ...]]:
        """The numbers in which the cases of a reuse group differ (SI), in the order of the cases."""
        return map(self._numbers_of, self.places)

    @property
    def parameters(self) -> Iterator[Mapping[str, Any]]:
        """Parameters of the cases, in their order."""
        return (self.points[number].parameters for number in self.places)

    def home_of(self) -> Callable[[str], Path | None]:
        """Return a function that finds the directory of the file of its mesh for the key of a case."""
        if len(self._homes.distinct) == 1:
            [home] = self._homes.distinct
            return lambda key: home
        return {self._key(place): self._homes[place] for place in self.places}.get

    def chosen(self, places: Sequence[int]) -> Cases:
        """Return some of the cases in another order, by their places among these."""
        return self._view(array("q", (self.places[place] for place in places)))

    def _view(self, places: Sequence[int]) -> Cases:
        view = copy(self)
        view.places = places
        return view

    def _numbers_of(self, place: int) -> tuple[float, ...]:
        return tuple(self._numbers[self._ends[place] : self._ends[place + 1]])

    def _key(self, place: int) -> str:
        return self._keys[_DIGITS * place : _DIGITS * (place + 1)].decode()

    def __len__(self) -> int:
        return len(self.places)

    @overload
    def __getitem__(self, place: int) -> Case: ...

    @overload
    def __getitem__(self, place: slice) -> Cases: ...

    def __getitem__(self, place: int | slice) -> Case | Cases:
        if isinstance(place, slice):
            return self._view(self.places[place])
        number = self.places[place]
        parameters, given = self.points[number]
        return Case(
            number,
            self._key(number),
            self._reuse_groups[number],
            self._numbers_of(number),
            parameters,
            self.settings(given),
            self._homes[number],
        )

    def __iter__(self) -> Iterator[Case]:
        return map(self.__getitem__, range(len(self)))


def title_of(number: int, parameters: Mapping[str, Any]) -> str:
    """Return what messages call a case."""
    return ", ".join((f"case {number}", *texts_of(parameters)))
