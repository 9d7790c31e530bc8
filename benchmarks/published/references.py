"""The tables of published values, ``SOURCE/references.csv``.

| column | content |
|---|---|
| job | name of the job file in the folder, without ``.yaml`` |
| changes | settings of the job for this row, such as ``mesh.parameters.n=4; discretisation.displacement=1`` |
| quantity | a quantity of the job, as they give it: ``NAME``, or ``NAME[i]`` for a component |
| value, unit | the published number with all its digits, and its unit (empty: a pure number) |
| spread | their uncertainty in the same unit; empty: one unit of the last digit |
| comparison | ``mesh``: both solve the same discrete problem; ``limit``: the exact solution, our estimate counts |
| finer | settings of finer meshes, divided by ``|``: our error is from changes on them, if one mesh gives none |
| loaded | for an inverse row, the forward job (with the same changes) whose loaded body is its mesh |
| small | ``yes`` for rows that the tests run |
| source, place | DOI or repository with commit; table, figure, or file with line |
| note | what the reader has to know of this row |
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import yaml

from hpcinv.base.quantity.units import parse_unit

FOLDER = Path(__file__).parent
COLUMNS = (
    "job",
    "changes",
    "quantity",
    "value",
    "unit",
    "spread",
    "comparison",
    "finer",
    "loaded",
    "small",
    "source",
    "place",
    "note",
)
COMPARISONS = ("mesh", "limit")


class TableError(Exception):
    """A table of published values that cannot be read; the message names file, line and column."""


@dataclass(frozen=True)
class PublishedValue:
    """One published value.

    Attributes:
        folder: name of the source.
        value: in the unit of the table, as printed.
        spread: in the unit of the table.
        factor: from the unit of the table to SI.
        finer: settings of each finer mesh.
    """

    folder: str
    line: int
    job: str
    changes: Mapping[str, Any]
    quantity: str
    value: str
    spread: float
    unit: str
    factor: float
    comparison: str
    finer: tuple[Mapping[str, Any], ...]
    loaded: str
    small: bool
    source: str
    place: str
    note: str

    @property
    def case(self) -> tuple[str, str, str, str]:
        """Rows of the same case come from one run."""
        return self.folder, self.job, f"{sorted(self.changes.items())}{self.finer or ''}", self.loaded


def sources() -> list[str]:
    """Return the names of all sources."""
    return sorted(path.parent.name for path in FOLDER.glob("*/references.csv"))


def last_digit(value: str) -> float:
    """Return one unit of the last printed digit: 0.01 for ``14.74``, 1e-7 for ``8.4e-6``."""
    mantissa, _, exponent = value.lower().partition("e")
    decimals = len(mantissa.partition(".")[2])
    return float(Fraction(10) ** (int(exponent or 0) - decimals))


def read(source: str) -> list[PublishedValue]:
    """Return the published values of a source.

    Raises:
        TableError: a column is missing, or a cell cannot be read.
    """
    path = FOLDER / source / "references.csv"
    with path.open(newline="", encoding="utf-8") as file:
        rows = csv.DictReader(file)
        if tuple(rows.fieldnames or ()) != COLUMNS:
            raise TableError(f"{path}: the columns must be {', '.join(COLUMNS)}")
        return [_reference(source, path, rows.line_num, row) for row in rows]


def _reference(source: str, path: Path, line: int, row: Mapping[str, str]) -> PublishedValue:
    try:
        if row["comparison"] not in COMPARISONS:
            raise ValueError(f"comparison must be one of {', '.join(COMPARISONS)}")
        return PublishedValue(
            folder=source,
            line=line,
            job=row["job"],
            changes=dict(_changes(row["changes"])),
            quantity=row["quantity"],
            value=row["value"],
            spread=float(row["spread"]) if row["spread"] else last_digit(row["value"]),
            unit=row["unit"],
            factor=float(parse_unit(row["unit"])[0]) if row["unit"] else 1.0,
            comparison=row["comparison"],
            finer=tuple(dict(_changes(mesh)) for mesh in row["finer"].split("|") if mesh.strip()),
            loaded=row["loaded"],
            small=row["small"] == "yes",
            source=row["source"],
            place=row["place"],
            note=row["note"],
        )
    except (ValueError, TypeError) as error:
        raise TableError(f"{path}: line {line}: {error}") from error


def _changes(text: str) -> Iterator[tuple[str, Any]]:
    for setting in filter(None, (part.strip() for part in text.split(";"))):
        key, equals, value = setting.partition("=")
        if not equals:
            raise ValueError(f"changes: {setting!r} is not of the form KEY=VALUE")
        yield key.strip(), yaml.safe_load(value)


def cases(references: Iterable[PublishedValue]) -> dict[tuple[str, str, str, str], list[PublishedValue]]:
    """Return the rows by case, in the order of the table."""
    grouped: dict[tuple[str, str, str, str], list[PublishedValue]] = {}
    for reference in references:
        grouped.setdefault(reference.case, []).append(reference)
    return grouped
