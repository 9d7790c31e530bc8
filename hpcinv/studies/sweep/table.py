"""Table of a sweep: a row for each case, with its parameters, results and costs; statistics of its quantities."""

import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import h5py
import numpy as np

from hpcinv.base.quantity.written_units import written_units
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.tables import Columns, fill, in_written_units, unit_of
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
TEXT = ("status", "certificate", "geometry_error", "started_from")
"""columns with text"""
FIXED = frozenset({"number", "key", *OUTCOME, *COSTS})
"""columns of every table"""
_UNITS = {"seconds": "s", "peak_memory": "B"}


def columns(plan: SweepPlan, records: Mapping[str, CaseRecord]) -> Columns:
    """Return a list for each column, with an entry for each case; numbers are SI, ``None`` if unknown.

    Args:
        records: of finished cases by key; others are ``open``.
    """
    rows = [records.get(key) for key in plan.cases.keys]
    columns_by_name: Columns = {
        "number": [*plan.cases.places],
        "key": [*plan.cases.keys],
    }
    columns_by_name |= {parameter_name(key): values for key, values in parameter_columns(plan).items()}
    for name, value_of in OUTCOME.items():
        columns_by_name[name] = _column(rows, value_of, "open" if name == "status" else "")
    taken = _taken(plan)
    for name, values in _results(rows):
        columns_by_name[_result_name(name, taken)] = values
    for name, value_of in COSTS.items():
        columns_by_name[name] = _column(rows, value_of, "" if name in TEXT else None)
    return columns_by_name


def _column(rows: Sequence[CaseRecord | None], value_of: Callable[[CaseRecord], Any], unknown: Any) -> list[Any]:
    return [unknown if row is None else value_of(row) for row in rows]


def units(plan: SweepPlan, records: Mapping[str, CaseRecord]) -> dict[str, str]:
    """Return the SI units of the columns, as far as they are known."""
    units_by_name = _UNITS | {parameter_name(key): unit for key, unit in parameter_units(plan).items()}
    taken, seen = _taken(plan), set[str]()
    for place, key in enumerate(plan.cases.keys):
        record = records.get(key)
        quantities = {} if record is None else record.statistics.get("quantities", {})
        if not quantities.keys() - seen:
            continue
        seen |= quantities.keys()
        job = plan.job(plan.cases[place])
        parameter_units_by_key = {p.key: p.dimension.unit for p in job.differentiated if p.dimension is not None}
        for name, value in quantities.items():
            unit = unit_of(f"quantities.{name}", job)
            for part in _parts(name, value):
                units_by_name |= {
                    _result_name(part + suffix, taken): unit for suffix in ("", " estimated error", " sd")
                }
                units_by_name |= {
                    f"{part} slope in {key}": _quotient(unit, parameter_unit)
                    for key, parameter_unit in parameter_units_by_key.items()
                }
    return units_by_name


def quantity_columns(plan: SweepPlan, records: Mapping[str, CaseRecord]) -> list[str]:
    """Return the columns of quantities of interest, one for each component of a vector."""
    taken = _taken(plan)
    parts_by_quantity = (
        _parts(n, v) for record in records.values() for n, v in record.statistics.get("quantities", {}).items()
    )
    return list(dict.fromkeys(_result_name(part, taken) for parts in parts_by_quantity for part in parts))


def as_hdf5(plan: SweepPlan, records: Mapping[str, CaseRecord], provenance: Iterable[str]) -> bytes:
    """Return the table as HDF5: in ``cases`` a dataset for each column, and ``provenance``, JSON text of each case."""
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        file.attrs["sweep"] = plan.sweep.sweep
        fill(file.create_group("cases"), columns(plan, records), units(plan, records))
        file.create_dataset("provenance", data=list(provenance), dtype=h5py.string_dtype())
    return content.getvalue()


def parameter_name(key: str) -> str:
    """Return the column of a parameter, different from the columns of every table."""
    return f"parameters.{key}" if key in FIXED else key


def parameter_names(plan: SweepPlan) -> list[str]:
    """Return the columns of parameters."""
    return [parameter_name(key) for key in dict.fromkeys(key for values in plan.cases.parameters for key in values)]


def _taken(plan: SweepPlan) -> frozenset[str]:
    """Return the names of columns that are not quantities."""
    return FIXED.union(parameter_names(plan))


def _result_name(name: str, taken: frozenset[str]) -> str:
    return f"quantities.{name}" if name in taken else name


def _quotient(unit: str, divisor: str) -> str:
    divisor_text = divisor if divisor.isalpha() else f"({divisor})"
    return f"{unit or 1}/{divisor_text}" if divisor else unit


def _solution_sum(record: CaseRecord, key: str) -> int | None:
    solutions = record.statistics.get("solutions", [])
    return sum(solution[key] for solution in solutions) if solutions else None


def _results(rows: list[CaseRecord | None]) -> Iterator[tuple[str, list[Any]]]:
    """Yield the columns of quantities of interest, of their estimated errors, and of their sensitivities."""
    every: list[dict[str, Any]] = [{} if row is None else dict(_values(row)) for row in rows]
    for name in dict.fromkeys(name for values in every for name in values):
        yield name, [values.get(name) for values in every]


def _values(record: CaseRecord) -> Iterator[tuple[str, float | None]]:
    """Yield the numbers of one case by column."""
    estimate = record.estimate.get("quantities", {})
    sensitivities = (record.statistics.get("sensitivities") or {}).get("quantities", {})
    for name, value in record.statistics.get("quantities", {}).items():
        yield from _parts(name, value).items()
        if name in estimate:
            yield from _parts(name, estimate[name], " estimated error").items()
        if name in sensitivities:
            for key, slope in sensitivities[name]["slopes"].items():
                yield from _parts(name, slope, f" slope in {key}").items()
            if sensitivities[name]["sd"] is not None:
                yield from _parts(name, sensitivities[name]["sd"], " sd").items()


def _parts(name: str, value: Any, suffix: str = "") -> dict[str, float | None]:
    """Return a number by its name, or the components of a vector by their names."""
    if isinstance(value, list):
        return {f"{name}[{i}]{suffix}": v for i, v in enumerate(value)}
    return {f"{name}{suffix}": value}


QUANTILES = {"minimum": 0.0, "5 %": 0.05, "median": 0.5, "95 %": 0.95, "maximum": 1.0}


def symbols(plan: SweepPlan) -> dict[str, str]:
    """Return the units in which the job of a sweep is written, by SI unit."""
    return written_units(plan.job(plan.cases[0]).data)


def statistics(plan: SweepPlan, records: Mapping[str, CaseRecord]) -> Columns:
    """Return a row for each quantity of interest and each combination of branches, over the converged cases.

    Values are in the units of the job.

    ``sd`` is the population's, estimated with ``n - 1``; ``sd of mean`` is ``sd/√n``, as for independent draws.
    """
    quantities, names = quantity_columns(plan, records), plan.sweep.branches
    table, unit = in_written_units(columns(plan, records), units(plan, records), symbols(plan))
    labels = list(zip(*(table[name] for name in names), strict=True)) or [()] * len(plan.cases)
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
