"""Table of a sweep: a row for each case, with its parameters, results and costs; statistics of its quantities."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import h5py
import numpy as np

from hpcinv.base.quantity.written_units import written_units
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.tables import Columns, fill, in_written_units, unit_of
from hpcinv.studies.sweep.cases import Labels
from hpcinv.studies.sweep.parameter_columns import parameter_columns, parameter_units
from hpcinv.studies.sweep.sweep_plan import SweepPlan

OUTCOME: Mapping[str, Callable[[CaseRecord], Any]] = {
    "status": lambda record: record.status,
    "certificate": lambda record: record.verdict,
    "geometry_error": lambda record: record.estimate.get("geometry", ""),
}
COSTS: Mapping[str, Callable[[CaseRecord], Any]] = {
    "seconds": lambda record: record.seconds,
    "factorizations": lambda record: _solution_sum(record, "factorizations"),
    "newton_iterations": lambda record: _solution_sum(record, "newton_iterations"),
    "unknowns": lambda record: record.statistics.get("mesh", {}).get("unknowns"),
    "ranks": lambda record: record.statistics.get("machine", {}).get("ranks"),
    "peak_memory": lambda record: max(record.statistics.get("peak_memory", {}).get("ranks", ()), default=None),
    "attempts": lambda record: record.attempts,
    "started_from": lambda record: record.start,
}
_SAME_FOR_ALL = {**OUTCOME, **COSTS}
TEXT = ("status", "certificate", "geometry_error", "started_from")
"""columns with text"""
FIXED = frozenset({"number", "key", *OUTCOME, *COSTS})
"""columns of every table"""
_UNKNOWN = {**dict.fromkeys(TEXT, ""), "status": "open"}
_UNITS = {"seconds": "s", "peak_memory": "B"}


class SweepTable:
    """Table of a sweep: a row for each case.

    Args:
        records: key and record of each finished case, whole or brief, in any order; none is kept.

    Attributes:
        finished: keys of the finished cases, each with its number among them.
    """

    def __init__(self, plan: SweepPlan, records: Iterable[tuple[str, CaseRecord]]) -> None:
        self.plan, self.finished = plan, dict[str, int]()
        self._parameters = {parameter_name(key): values for key, values in parameter_columns(plan).items()}
        self._columns: Columns = {name: [] for name in _SAME_FOR_ALL}  # of the finished cases
        self._results: list[tuple[Any, ...]] = []
        self._names, self._shapes = Labels[tuple[str, ...]](), Labels[tuple[tuple[str, int | None], ...]]()
        for key, record in records:
            self.finished[key] = len(self.finished)
            self._add(record)

    def columns(self) -> Columns:
        """Return a list for each column, with an entry for each case; numbers are SI, ``None`` if unknown."""
        cases, rows = self.plan.cases, self._rows()
        columns_by_name: Columns = {"number": [*cases.places], "key": [*cases.keys], **self._parameters}
        columns_by_name |= {name: self._column(name, rows) for name in OUTCOME}
        results = {name: [None] * len(rows) for names in self._in_order(self._names) for name in names}
        columns_by_label = [[results[name] for name in names] for names in self._names.distinct]
        for place, row in enumerate(rows):
            if row is not None:
                for values, value in zip(columns_by_label[self._names.column[row]], self._results[row], strict=True):
                    values[place] = value
        columns_by_name |= {self._result_name(name): values for name, values in results.items()}
        return columns_by_name | {name: self._column(name, rows) for name in COSTS}

    def units(self) -> dict[str, str]:
        """Return the SI units of the columns, as far as they are known."""
        units_by_name = _UNITS | {parameter_name(key): unit for key, unit in parameter_units(self.plan).items()}
        seen = set[str]()
        for place, shape in self._first_places(self._shapes):
            if not {name for name, _ in shape} - seen:
                continue
            seen |= {name for name, _ in shape}
            job = self.plan.job(self.plan.cases[place])
            parameter_units_by_key = {p.key: p.dimension.unit for p in job.differentiated if p.dimension is not None}
            for name, length in shape:
                unit = unit_of(f"quantities.{name}", job)
                for part in _part_names(name, length):
                    units_by_name |= {
                        self._result_name(part + suffix): unit for suffix in ("", " estimated error", " sd")
                    }
                    units_by_name |= {
                        f"{part} slope in {key}": _quotient(unit, parameter_unit)
                        for key, parameter_unit in parameter_units_by_key.items()
                    }
        return units_by_name

    def quantities(self) -> list[str]:
        """Return the columns of quantities of interest, one for each component of a vector."""
        names = (part for shape in self._in_order(self._shapes) for entry in shape for part in _part_names(*entry))
        return list(dict.fromkeys(map(self._result_name, names)))

    def as_hdf5(self, provenance: Iterable[str]) -> bytes:
        """Return it as HDF5: in ``cases`` a dataset for each column, and ``provenance``, JSON text of each case."""
        content = io.BytesIO()
        with h5py.File(content, "w") as file:
            file.attrs["sweep"] = self.plan.sweep.sweep
            fill(file.create_group("cases"), self.columns(), self.units())
            file.create_dataset("provenance", data=list(provenance), dtype=h5py.string_dtype())
        return content.getvalue()

    def in_units_of_the_job(self) -> tuple[Columns, dict[str, str]]:
        """Return columns and units as `in_written_units` for the job of the sweep."""
        symbols = written_units(self.plan.job(self.plan.cases[0]).data)
        return in_written_units(self.columns(), self.units(), symbols)

    def _add(self, record: CaseRecord) -> None:
        for name, value_of in _SAME_FOR_ALL.items():
            self._columns[name].append(value_of(record))
        values = dict(_values(record))
        self._names.append(tuple(values))
        self._results.append((*values.values(),))
        quantities = record.statistics.get("quantities", {})
        self._shapes.append(tuple((n, len(v) if isinstance(v, list) else None) for n, v in quantities.items()))

    def _rows(self) -> list[int | None]:
        """Return for each case its number among the finished ones; ``None`` if it is open."""
        return [*map(self.finished.get, self.plan.cases.keys)]

    def _column(self, name: str, rows: Sequence[int | None]) -> list[Any]:
        values, unknown = self._columns[name], _UNKNOWN.get(name)
        return [unknown if row is None else values[row] for row in rows]

    def _first_places[T](self, labels: Labels[T]) -> list[tuple[int, T]]:
        """Return each label with the place of the first case that has it, in the order of the cases."""
        first: dict[int, int] = {}
        for place, row in enumerate(self._rows()):
            if row is not None:
                first.setdefault(labels.column[row], place)
        return [(place, labels.distinct[number]) for number, place in first.items()]

    def _in_order[T](self, labels: Labels[T]) -> list[T]:
        return [label for _, label in self._first_places(labels)]

    def _result_name(self, name: str) -> str:
        """Return the column of a result, different from the other columns."""
        return f"quantities.{name}" if name in FIXED or name in self._parameters else name


def parameter_name(key: str) -> str:
    """Return the column of a parameter, different from the columns of every table."""
    return f"parameters.{key}" if key in FIXED else key


def parameter_names(plan: SweepPlan) -> list[str]:
    """Return the columns of parameters."""
    return [parameter_name(key) for key in dict.fromkeys(key for values in plan.cases.parameters for key in values)]


def _quotient(unit: str, divisor: str) -> str:
    divisor_text = divisor if divisor.isalpha() else f"({divisor})"
    return f"{unit or 1}/{divisor_text}" if divisor else unit


def _solution_sum(record: CaseRecord, key: str) -> int | None:
    solutions = record.statistics.get("solutions", [])
    return sum(solution[key] for solution in solutions) if solutions else None


def _values(record: CaseRecord) -> Iterator[tuple[str, float | None]]:
    """Yield the numbers of one case by column."""
    estimate = record.estimate.get("quantities", {})
    sensitivities = (record.statistics.get("sensitivities") or {}).get("quantities", {})
    for name, value in record.statistics.get("quantities", {}).items():
        yield from _parts(name, value)
        if name in estimate:
            yield from _parts(name, estimate[name], " estimated error")
        if name in sensitivities:
            for key, slope in sensitivities[name]["slopes"].items():
                yield from _parts(name, slope, f" slope in {key}")
            if sensitivities[name]["sd"] is not None:
                yield from _parts(name, sensitivities[name]["sd"], " sd")


def _parts(name: str, value: Any, suffix: str = "") -> Iterator[tuple[str, float | None]]:
    """Yield a number by its name, or the components of a vector by their names."""
    if isinstance(value, list):
        yield from ((f"{part}{suffix}", v) for part, v in zip(_part_names(name, len(value)), value, strict=True))
    else:
        yield f"{name}{suffix}", value


def _part_names(name: str, length: int | None) -> list[str]:
    """Return the names of the components of a vector of a length, or of a number."""
    return [name] if length is None else [f"{name}[{i}]" for i in range(length)]


QUANTILES = {"minimum": 0.0, "5 %": 0.05, "median": 0.5, "95 %": 0.95, "maximum": 1.0}


def statistics(sweep_table: SweepTable) -> Columns:
    """Return a row for each quantity of interest and each combination of branches, over the converged cases.

    Values are in the units of the job.

    ``sd`` is the population's, estimated with ``n - 1``; ``sd of mean`` is ``sd/√n``, as for independent draws.
    """
    quantities, names = sweep_table.quantities(), sweep_table.plan.sweep.branches
    table, unit = sweep_table.in_units_of_the_job()
    labels = list(zip(*(table[name] for name in names), strict=True)) or [()] * len(sweep_table.plan.cases)
    columns_by_name: Columns = {
        name: [] for name in (*names, "quantity", "unit", "cases", "mean", "sd", "sd of mean", *QUANTILES)
    }
    for group in dict.fromkeys(labels):
        for quantity in quantities:
            values = [v for v, label in zip(table[quantity], labels, strict=True) if label == group and v is not None]
            if values:
                row = [*group, quantity, unit.get(quantity, ""), len(values), *_moments(values)]
                row += [float(np.quantile(values, share)) for share in QUANTILES.values()]
                for column, value in zip(columns_by_name.values(), row, strict=True):
                    column.append(value)
    return columns_by_name


def _moments(values: Sequence[float]) -> tuple[float, float | None, float | None]:
    mean = float(np.mean(values))
    if len(values) < 2:
        return mean, None, None
    sd = float(np.std(values, ddof=1))
    return mean, sd, sd / len(values) ** 0.5
