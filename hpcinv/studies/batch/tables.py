"""Tables as files: columns with units as CSV, and as HDF5 datasets."""

import csv
import io
import math
import re
from collections.abc import Mapping
from typing import Any

import h5py
import numpy as np

from hpcinv.base.quantity.units import is_prefixed, parse_unit, prefixed_unit
from hpcinv.job.job import Job

type Columns = dict[str, list[Any]]


def as_csv(columns: Columns, units: Mapping[str, str]) -> str:
    """Return columns as CSV under headers with their units, such as ``tip [m]``; unknown values are empty.

    Texts that a spreadsheet would take as formulas begin with an apostrophe.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([_as_text(f"{name} [{units[name]}]" if units.get(name) else name) for name in columns])
    for values in zip(*columns.values(), strict=True):
        writer.writerow([_entry(value) for value in values])
    return text.getvalue()


def in_written_units(
    columns: Columns, units: Mapping[str, str], symbols: Mapping[str, str]
) -> tuple[Columns, dict[str, str]]:
    """Return columns in the units of the screen, and the units: the job's, or one with a prefix for all columns.

    Args:
        symbols: of the units in which the job is written, by SI unit.
    """
    symbols = _prefixed(columns, units) | dict(symbols)
    written = {column: symbols.get(unit, unit) for column, unit in units.items()}
    return {
        column: [as_written(value, units.get(column, ""), symbols) for value in values]
        for column, values in columns.items()
    }, written


def _prefixed(columns: Columns, units: Mapping[str, str]) -> dict[str, str]:
    """Return the units with prefixes that suit the largest numbers, by SI unit."""
    largest = dict[str, float]()
    for column, values in columns.items():
        numbers = [abs(v) for v in values if isinstance(v, int | float) and math.isfinite(v)]
        if unit := units.get(column, ""):
            largest[unit] = max([largest.get(unit, 0.0), *numbers])
    return {unit: prefixed_unit(value, unit)[1] for unit, value in largest.items() if is_prefixed(unit)}


def as_written(value: Any, unit: str, symbols: Mapping[str, str]) -> Any:
    """Return an SI number in the unit of a job, to 15 digits; texts, flags and unknown values as they are."""
    if unit not in symbols or isinstance(value, bool) or not isinstance(value, int | float):
        return value
    return float(f"{value / parse_unit(symbols[unit])[0]:.15g}")


_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_QUANTITY = re.compile(r"[-+]?[\d.]+(e[-+]?\d+)?( [A-Za-zµ°%][A-Za-z0-9µ°%^*/. -]*)?", re.IGNORECASE)


def _entry(value: Any) -> Any:
    if isinstance(value, float):
        return repr(value)
    return _as_text(value) if isinstance(value, str) else "" if value is None else value


def _as_text(text: str) -> str:
    return f"'{text}" if text.startswith(_FORMULA) and not _QUANTITY.fullmatch(text) else text


def fill(group: h5py.Group, columns: Columns, units: Mapping[str, str]) -> None:
    """Write a dataset for each column: text, flags, or numbers with NaN for unknown values."""
    for column, values in columns.items():
        name = column.replace("/", "|")  # HDF5 reads it as a path
        if all(isinstance(v, str) for v in values):
            data = group.create_dataset(name, data=values, dtype=h5py.string_dtype())
        elif all(isinstance(v, bool | int) for v in values):
            data = group.create_dataset(name, data=np.array(values))
        else:
            data = group.create_dataset(name, data=np.array([np.nan if v is None else v for v in values], dtype=float))
        if units.get(column):
            data.attrs["unit"] = units[column]


_IN_SUMMARY = {"max": "m", "rms": "m", "strain_energy": "J", "total": "s"}


def unit_of(key: str, job: Job) -> str:
    """Return the unit of the number at a key of the summary; empty for pure numbers and where it is not known."""
    names = {quantity.name: quantity for quantity in job.quantities}
    name = key.removeprefix("quantities.").partition("[")[0]
    if not key.startswith("quantities.") or name not in names:
        return _IN_SUMMARY.get(key.rpartition(".")[2], "")
    return names[name].unit
