"""Rows of tables in text files (CSV), as spreadsheets of any language write them."""

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import dropwhile
from pathlib import Path
from typing import Self

from hpcinv.base.quantity.decimal_marks import COMMA, OPEN, POINT, decimal_marks, number_of
from hpcinv.base.reading.decoding import decoded
from hpcinv.base.reading.door import admitted

_SEARCHED = 200
"""Rows ahead of the titles; raised, a wrong file takes longer to be refused."""


@dataclass(frozen=True)
class Row:
    """A line of a table.

    Attributes:
        line: number of the line, from 1.
        entries: texts between the delimiters.
        marks: decimal mark of each entry, by its column (`hpcinv.base.quantity.decimal_marks`).
    """

    line: int
    entries: tuple[str, ...]
    marks: tuple[str, ...]

    def number(self, column: int) -> float:
        """Return the number in a column; ``ValueError`` with the reason if it is none."""
        return number_of(self.entries[column], self.marks[column])

    def without_first(self) -> Self:
        """Return the row without its first entry, such as a label."""
        return replace(self, entries=self.entries[1:], marks=self.marks[1:])

    def is_number(self, column: int) -> bool:
        """Return whether the entry in a column is a number."""
        try:
            self.number(column)
        except ValueError:
            return False
        return True

    @property
    def has_only_numbers(self) -> bool:
        return all(map(self.is_number, range(len(self.entries))))

    @property
    def has_numbers(self) -> bool:
        """True if some entry begins as a number does: a row of titles has none."""
        return any(re.match(r"[+-]?[.,]?\d", entry) for entry in self.entries)


def below_titles(rows: Sequence[Row], columns: Sequence[int]) -> Sequence[Row]:
    """Return the rows below the titles of a table of numbers, and below what a program wrote ahead of them.

    Args:
        columns: numbers of entries that a row of titles may have.
    """
    for i, row in enumerate(rows[:_SEARCHED]):
        if len(row.entries) in columns and not row.has_numbers:
            titled = next((k for k, below in enumerate(rows[i:], start=i) if below.has_numbers), len(rows))
            return rows[titled:]
        if len(row.entries) in columns and sum(map(row.is_number, range(len(row.entries)))) >= min(columns) - 1:
            break  # a row of the table
    return list(dropwhile(lambda row: not row.has_numbers, rows))


def rows_of(text: str, delimiter: str = "", *, decimal_comma: bool = False) -> list[Row | tuple[int, str]]:
    """Return the rows of a table that are not empty, and comments (``#``) as their line and text.

    Args:
        delimiter: of entries; left out, the first row decides: tabs, else semicolons, else commas.
        decimal_comma: whether commas in entries are decimal, also where commas delimit entries.

    Raises:
        ValueError: a row cannot be read; with the line and the reason.
    """
    given = list(enumerate(text.removeprefix("\ufeff").splitlines(), start=1))
    delimiter = delimiter or _delimiter_of(line for _, line in given)
    lines: list[tuple[int, list[str] | str]] = []
    for number, line in given:
        if line.lstrip().startswith("#"):
            lines.append((number, line.lstrip("# \t")))
        elif line.strip(" \t,;"):
            lines.append((number, _entries(number, line, delimiter)))
    rows = [entries for _, entries in lines if not isinstance(entries, str)]
    unknown = COMMA if delimiter == ";" else OPEN  # American programs write no semicolons
    marks = decimal_marks(rows, unknown, COMMA if decimal_comma else OPEN)
    if delimiter == "," and not decimal_comma:  # commas that delimit are not decimal
        marks = [mark if mark == POINT else OPEN for mark in marks]
    return [
        (number, entries) if isinstance(entries, str) else Row(number, tuple(entries), tuple(marks[: len(entries)]))
        for number, entries in lines
    ]


def _delimiter_of(lines: Iterable[str]) -> str:
    """Return what delimits the entries of the first row: tabs, else semicolons, else commas."""
    first = next((line for line in lines if line.strip(" \t,;") and not line.lstrip().startswith("#")), "")
    return next((delimiter for delimiter in "\t;" if delimiter in first), ",")


def _entries(number: int, line: str, delimiter: str) -> list[str]:
    try:
        return [entry.strip() for entry in next(csv.reader([line], delimiter=delimiter))]
    except csv.Error as error:  # an entry of more than 131,072 characters
        raise ValueError(f"line {number}: cannot be read: {error}") from None


def text_of(path: Path, most: int) -> str:
    """Return the text of a file of at most so many bytes, as `decoded`; ``ValueError`` if there is none."""
    return decoded(content_of(path, most))[0]


def content_of(path: Path, most: int) -> bytes:
    """Return the bytes of a file, at most so many; ``ValueError`` with the reason if they cannot be read."""
    try:
        if (size := path.stat().st_size) > most:
            raise ValueError(f"has {size:,} bytes, and may have {most:,}")
        return admitted(path).read_bytes()
    except OSError as error:
        raise ValueError(f"cannot be read: {error.strerror}") from None
