"""Axes from tables: a row is a point, a column a key of the job, and one column may name the points."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hpcinv.base.quantity.csv_rows import Row
from hpcinv.base.quantity.decimal_marks import AmbiguousNumber
from hpcinv.base.quantity.keys import parse_key
from hpcinv.base.quantity.schema import shown
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.table_files import readings_of
from hpcinv.base.quantity.units import is_unit
from hpcinv.job.job import Job

_LARGEST = 50_000_000
"""Bytes of a table; raised, a wrong file takes minutes to be refused."""
_TITLE = re.compile(r"\s*(.*?)\s*(?:\[([^\[\]\d]*)\]|\(([^()]*)\))?\s*", re.DOTALL)
_INTEGER = re.compile(r"[+-]?\d+")


def _index_of(titles: Row, name: str) -> int | None:
    return next((i for i, title in enumerate(titles.entries) if _split(title)[0] == name), None)


def _check_lengths(titles: Row, data: Sequence[Row], last: int) -> None:
    """Raise ``ValueError`` for a row without an entry in the last column that is read."""
    for row in data:
        if last >= len(row.entries):
            raise ValueError(
                f"line {row.line}: has {len(row.entries)} entries, but there are {len(titles.entries)} columns"
            )


def _branch(point: Mapping[str, Any]) -> dict[str, Any]:
    return {"axes": [{"zip": {key: [value] for key, value in point.items()}}]}


def axis_of(path: Path, name: str, columns: Mapping[str, str] | None) -> dict[str, Any]:
    """Return the content of an axis: lists of values by key, or branches if a column names the points.

    Args:
        name: title of the column with labels; it need not be there.
        columns: titles of columns by key, if they differ; other columns are not used then.

    Raises:
        ValueError: the file is not such a table; with the line and the reason.
    """
    rows = _rows(path, name, columns)
    titles, *data = rows
    keys = _keys(titles, name, columns)
    labels = _index_of(titles, name)
    units: Sequence[str] = ()
    if data and not data[0].has_numbers and _are_units(data[0], keys):
        units, data = data[0].entries, data[1:]
    if not data:
        raise ValueError("has no rows below the names of its columns")
    _check_lengths(titles, data, max([*keys, labels or 0]))
    points = [{key: _value(row, i, unit or _bare(units, i)) for i, (key, unit) in keys.items()} for row in data]
    if labels is None:
        return {"zip": {key: [point[key] for point in points] for key in points[0]}}
    names: list[str] = []
    for row in data:
        names.append(_label(row, labels, names))
    branches = {label: _branch(point) for label, point in zip(names, points, strict=True)}
    return {"branches": branches, "name": name}


def _label(row: Row, column: int, earlier: Sequence[str]) -> str:
    label = row.entries[column]
    if not label or label in earlier:
        raise ValueError(f"line {row.line}: the label '{label}' is {'a duplicate' if label else 'missing'}")
    return label


def _rows(path: Path, name: str, columns: Mapping[str, str] | None) -> list[Row]:
    """Return the rows from the one that names most columns, in the way of reading the file that names most."""
    best, most = list[Row](), 0
    first: list[Row] = []
    for way in readings_of(path, _LARGEST):
        rows = [row for row in way.rows if isinstance(row, Row)]
        first = first or rows
        for i, row in enumerate(rows[:200]):
            count = sum(_is_known(title, columns) for title in row.entries)
            if count > most:
                best, most = rows[i:], count
    if not best:
        titles = ", ".join(first[0].entries[:6]) if first else "nothing"
        wanted = ", ".join((columns or {}).values()) or "keys of the job, such as material.c1 [kPa]"
        raise ValueError(f"no line names columns by {wanted}; the first has {shown(titles)}. Give 'columns' by key")
    return best


def _split(title: str) -> tuple[str, str]:
    """Return name and unit in a title such as ``material.c1 [kPa]``."""
    match = _TITLE.fullmatch(title)
    assert match is not None
    if match[3] and not is_unit(match[3]):  # a remark
        return title.strip(), ""
    return match[1], match[2] or match[3] or ""


def _is_known(title: str, columns: Mapping[str, str] | None) -> bool:
    if columns is not None:
        return title in columns.values() or _split(title)[0] in columns.values()
    return _is_key(_split(title)[0])


def _is_key(name: str) -> bool:
    try:
        return parse_key(name)[0] in Job.model_fields
    except ValueError:
        return False


def _check_titles(titles: Row, name: str) -> None:
    """Raise ``ValueError`` for a title that is neither a key of the job nor the name of the labels."""
    for title in titles.entries:
        text, _ = _split(title)
        if title and text != name and not _is_key(text):
            raise ValueError(
                f"line {titles.line}: the column '{title}' is not a key of the job;"
                f" give 'columns' by key, or 'name: {text}' if it has the labels of the points"
            )


def _keys(titles: Row, name: str, columns: Mapping[str, str] | None) -> dict[int, tuple[str, str]]:
    """Return key and unit by the index of a column."""
    split = [_split(title) for title in titles.entries]
    if columns is None:
        _check_titles(titles, name)
        return {i: (text, unit) for i, (text, unit) in enumerate(split) if text and text != name}
    keys: dict[int, tuple[str, str]] = {}
    for key, title in columns.items():
        places = [i for i, (text, _) in enumerate(split) if title in (text, titles.entries[i])]
        if len(places) != 1:
            hint = did_you_mean(title, [text for text, _ in split])
            raise ValueError(f"line {titles.line}: has {len(places) or 'no'} column '{title}' for {key}.{hint}")
        keys[places[0]] = key, split[places[0]][1]
    return keys


def _bare(units: Sequence[str], i: int) -> str:
    return units[i].strip(" []()") if i < len(units) else ""


def _are_units(row: Row, keys: Mapping[int, tuple[str, str]]) -> bool:
    texts = [_bare(row.entries, i) for i in keys]
    return any(texts) and all(map(is_unit, texts))


def _value(row: Row, i: int, unit: str) -> Any:
    text = row.entries[i]
    if not text:
        raise ValueError(f"line {row.line}: a value is missing in column {i + 1}")
    try:
        number = row.number(i)
    except AmbiguousNumber as error:
        raise ValueError(f"line {row.line}: {error}") from None
    except ValueError:
        return text  # with a unit of its own, or a name
    if unit not in ("", "-"):
        return f"{repr(number).removesuffix('.0')} {unit}"
    return int(text) if _INTEGER.fullmatch(text) else number
