"""Rows of tables in text files (CSV), as spreadsheets of any language write them."""

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from hpcinv.quantity.units import NUMBER
from hpcinv.reading.decoding import decoded
from hpcinv.reading.door import admitted

_NUMBER = re.compile(NUMBER)
_WITH_COMMA = re.compile(r"([+-]?\d*),(\d+(?:[eE][+-]?\d{1,3})?)")


@dataclass(frozen=True)
class Row:
    """A line of a table.

    Attributes:
        line: number of the line, from 1.
        entries: texts between the delimiters.
        has_decimal_commas: whether a comma in an entry can only be a decimal one, since others delimit entries.
    """

    line: int
    entries: tuple[str, ...]
    has_decimal_commas: bool

    def number(self, column: int) -> float:
        """Return the number in a column; ``ValueError`` with the reason if it is none."""
        text = self.entries[column]
        if self.has_decimal_commas:
            text = _WITH_COMMA.sub(r"\1.\2", text) if _WITH_COMMA.fullmatch(text) else text
        if not text:
            raise ValueError("is empty")
        if _NUMBER.fullmatch(text) is None:
            comma = "; a decimal comma is written as a point" if _WITH_COMMA.fullmatch(text) else ""
            raise ValueError(f"{shortened(text)} is not a number{comma}")
        return float(text)

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


def shortened(text: str) -> str:
    return repr(text) if len(text) <= 60 else f"{text[:57]!r}..."


def rows_of(text: str, delimiter: str = "", *, decimal_comma: bool = False) -> Iterator[Row | tuple[int, str]]:
    """Yield the rows of a table that are not empty, and comments (``#``) as their line and text.

    Args:
        delimiter: of entries; left out, the first row decides: tabs, else semicolons, else commas.
        decimal_comma: whether commas in entries between quotation marks are decimal ones, though others delimit.

    Raises:
        ValueError: a row cannot be read; with the line and the reason.
    """
    for number, line in enumerate(text.removeprefix("\ufeff").splitlines(), start=1):
        if line.lstrip().startswith("#"):
            yield number, line.lstrip("# \t")
        elif line.strip(" \t,;"):
            delimiter = delimiter or next((d for d in "\t;" if d in line), ",")
            try:
                entries = next(csv.reader([line], delimiter=delimiter))
            except csv.Error as error:  # an entry of more than 131,072 characters
                raise ValueError(f"line {number}: cannot be read: {error}") from None
            yield Row(number, tuple(entry.strip() for entry in entries), decimal_comma or delimiter != ",")


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
