"""Tables in files of text and in workbooks (``.xlsx``), with their rows as texts."""

from __future__ import annotations

import datetime
import io
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from hpcinv.base.quantity.csv_rows import Row, content_of, rows_of
from hpcinv.base.quantity.decimal_marks import COMMA, EXACT, OPEN, POINT, decimal_marks, is_grouped
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.reading.decoding import decoded
from hpcinv.errors import SystemPartMissing

_UNPACKED = 10
"""Unpacked size of a workbook as a multiple of the limit of files; raised, a hostile one can fill more memory."""
_MOST_ROWS = 1_000_000
"""Rows of a sheet, which is what spreadsheets allow; raised, reading takes minutes."""
_MOST_COLUMNS = 1000
_MOST_CELLS = 20_000_000
"""Cells of a sheet, with the empty ones up to the last of each row; raised, reading takes minutes."""
_DELIMITERS = {"\t": "tabs", ";": "semicolons", ",": "commas"}


@dataclass(frozen=True)
class TableReading:
    """A file, read in one way.

    Attributes:
        rows: those that are not empty, and comments (``#``) as their line and text.
        description: of encoding and delimiter, or of the sheet.
    """

    rows: list[Row | tuple[int, str]]
    description: str


def readings_of(
    path: Path, most: int, *, sheet: str | None = None, decimal_comma: bool = False
) -> Iterator[TableReading]:
    """Yield each way to read a file: a workbook, or text by each delimiter that occurs in it.

    Args:
        most: bytes of the file.
        sheet: of a workbook; left out, the first.

    Raises:
        ValueError: it is not a table; with the reason.
        SystemPartMissing: the package for workbooks is not installed.
    """
    content = content_of(path, most)
    if content.startswith(b"PK\x03\x04"):
        yield _workbook(content, most, sheet)
        return
    if content.startswith(b"\xd0\xcf\x11\xe0"):
        raise ValueError("is an old workbook (.xls); save it as .xlsx or .csv")
    if sheet is not None:
        raise ValueError(f"is not a workbook; it has no sheet '{sheet}'")
    text, encoding = decoded(content)
    for delimiter in [d for d in _DELIMITERS if d in text] or [","]:
        rows = rows_of(text, delimiter, decimal_comma=decimal_comma)
        yield TableReading(rows, f"{encoding}, columns between {_DELIMITERS[delimiter]}{_said_of_marks(rows)}")


def _workbook(content: bytes, most: int, sheet: str | None) -> TableReading:
    try:
        import openpyxl
    except ImportError:
        advice = "Install it by: pip install 'hpcinv[tables]', or save the table as .csv."
        raise SystemPartMissing("workbooks (.xlsx) are read by openpyxl, which is not installed", advice) from None
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as parts:
            if sum(part.file_size for part in parts.infolist()) > _UNPACKED * most:
                raise ValueError(f"unpacks to more than {_UNPACKED * most:,} bytes")
        book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
        names = book.sheetnames
        name = sheet if sheet is not None else names[0]
        if name not in names:
            raise ValueError(f"has no sheet '{name}'.{did_you_mean(name, names)}")
        book[name].reset_dimensions()  # else each row has as many cells as the file says
        rows = _rows(islice(book[name].iter_rows(values_only=True), _MOST_ROWS))
    except ValueError:
        raise
    except Exception as error:  # openpyxl raises whatever damaged files cause
        raise ValueError(f"is a workbook that cannot be read: {type(error).__name__}: {error}") from None
    others = f" (others: {', '.join(other for other in names if other != name)})" if len(names) > 1 else ""
    return TableReading(rows, f"workbook, sheet '{name}'{others}")


def _said_of_marks(rows: Sequence[Row | tuple[int, str]]) -> str:
    """Return what is understood of points and commas in numbers, if there is something to say."""
    pairs = {
        (mark, is_grouped(text, mark))
        for row in rows
        if isinstance(row, Row)
        for text, mark in zip(row.entries, row.marks, strict=True)
        if "," in text or mark == COMMA
    }
    said = ["decimal commas"] if any(mark == COMMA for mark, _ in pairs) else []
    said += ["commas between thousands"] if (POINT, True) in pairs else []
    said += ["points between thousands"] if (COMMA, True) in pairs else []
    return "".join(f", {text}" for text in said)


def _rows(cells_by_row: Iterator[tuple[Any, ...]]) -> list[Row | tuple[int, str]]:
    lines = list(_lines(cells_by_row))
    marks = decimal_marks([[text for text, _ in entries] for _, entries in lines if not isinstance(entries, str)], OPEN)
    return [
        (line, entries)
        if isinstance(entries, str)
        else Row(
            line,
            tuple(text or exact for text, exact in entries),
            tuple(EXACT if exact else mark for (_, exact), mark in zip(entries, marks, strict=False)),
        )
        for line, entries in lines
    ]


def _lines(cells_by_row: Iterator[tuple[Any, ...]]) -> Iterator[tuple[int, list[tuple[str, str]] | str]]:
    """Yield the number of a line and its entries, each as a text or as an exact number; or a comment."""
    count = 0
    for line, cells in enumerate(cells_by_row, start=1):
        count += len(cells)  # 0 in the empty rows before a formatted cell
        if count > _MOST_CELLS:
            raise ValueError(f"has more than {_MOST_CELLS:,} cells, many of them empty; save it as .csv")
        entries = [(_text(cell), _is_exact(cell)) for cell in cells[:_MOST_COLUMNS]]
        while entries and not entries[-1][0]:
            entries.pop()
        if entries and entries[0][0].startswith("#"):
            yield line, " ".join(text for text, _ in entries).lstrip("# \t")
        elif entries:
            yield line, [("", text) if is_exact else (text, "") for text, is_exact in entries]


def _is_exact(cell: Any) -> bool:
    return isinstance(cell, int | float) and not isinstance(cell, bool)


def _text(cell: Any) -> str:
    if cell is None:
        return ""
    if isinstance(cell, datetime.date | datetime.time):
        return cell.isoformat()
    return str(cell).strip() if isinstance(cell, str | bool) else repr(cell)
