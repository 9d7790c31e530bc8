"""Tables of a study as files: ``table.csv``, ``table.h5``, and ``statistics.csv`` if there are cases."""

import io
import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import h5py
import numpy as np

from hpcinv.studies.batch.specification import text_of
from hpcinv.studies.batch.tables import Columns, fill
from hpcinv.studies.study.findings import Accuracy
from hpcinv.studies.study.references import ReferenceValue
from hpcinv.studies.study.result_rows import StudyRow
from hpcinv.studies.study.study_plan import StudyPlan
from hpcinv.studies.study.study_spec import COSTS, STATISTICS


def run_columns(plan: StudyPlan, rows: Sequence[StudyRow], accuracies: Sequence[Accuracy]) -> Columns:
    """Return a row for each run; times in s, memory in bytes, values and errors in SI."""
    places = [row.place for row in rows]
    columns: Columns = {"series": [p.series for p in places], "label": [p.label for p in places]}
    columns |= _settings([p.varied for p in places])
    if plan.cases > 1:
        columns["case"] = [p.case for p in places]
    columns |= _settings([p.parameters for p in places])
    columns |= {name: list(map(value, rows)) for name, value in _OF_RUNS.items()}
    for name in rows[0].costs:
        columns[name] = [row.costs[name] for row in rows]
    for accuracy in accuracies:
        columns |= _accuracy_columns(rows, accuracy)
    return columns


def _settings(settings: Sequence[Mapping[str, Any]]) -> Columns:
    """Return a column for each key of some row."""
    keys = dict.fromkeys(key for own in settings for key in own)
    return {key: [text_of(own[key]) if key in own else "" for own in settings] for key in keys}


_OF_RUNS: dict[str, Callable[[StudyRow], Any]] = {
    "status": lambda row: row.status,
    "certificate": lambda row: row.certificate,
    "geometry_error": lambda row: row.geometry_error,
    "repetitions": lambda row: len(row.times),
    "time_min": lambda row: min(row.times, default=None),
    "time_max": lambda row: max(row.times, default=None),
}


def _accuracy_columns(rows: Sequence[StudyRow], accuracy: Accuracy) -> Columns:
    name = accuracy.name
    return {
        name: [row.values[name] for row in rows],
        f"{name} error": list(accuracy.errors),
        f"{name} relative error": [relative(accuracy, *pair) for pair in zip(rows, accuracy.errors, strict=True)],
        f"{name} order": list(accuracy.orders),
        f"{name} effectivity": list(accuracy.effectivities),
        f"{name} on Pareto front": [accuracy.point_of(row).is_on_front for row in rows],
    }


def run_units(accuracies: Sequence[Accuracy]) -> dict[str, str]:
    """Return the units of the columns of `run_columns` that have one."""
    units = COSTS | {"time_min": "s", "time_max": "s"}
    for accuracy in accuracies:
        units |= {accuracy.name: accuracy.unit, f"{accuracy.name} error": accuracy.unit}
    return units


def point_columns(plan: StudyPlan, accuracy: Accuracy) -> Columns:
    """Return a row for each step of each series: statistics of errors over the cases, and averages of costs."""
    points = accuracy.points
    columns: Columns = {"series": [p.series for p in points], "label": [p.label for p in points]}
    for name in points[0].statistics:
        columns[name] = [point.statistics[name] for point in points]
    columns["on Pareto front"] = [point.is_on_front for point in points]
    published_numbers = plan.study.beside
    published = published_numbers.statistics.get(accuracy.name, {}) if published_numbers else {}
    for name in dict.fromkeys(name for statistics in published.values() for name in statistics):
        columns[f"published {name}"] = [published.get(point.series, {}).get(name) for point in points]
    return columns


def point_units(accuracy: Accuracy) -> dict[str, str]:
    """Return the units of the columns of `point_columns` that have one."""
    names = (*STATISTICS, *(f"published {name}" for name in STATISTICS))
    return COSTS | dict.fromkeys(names, accuracy.unit)


def relative(accuracy: Accuracy, row: StudyRow, error: float | None) -> float | None:
    """Return the error over the reference; ``None`` if that is zero or missing."""
    reference = accuracy.references[row.place.case]
    if error is None or not isinstance(reference, ReferenceValue) or reference.value == 0.0:
        return None
    return error / abs(reference.value)


def as_hdf5(plan: StudyPlan, rows: Sequence[StudyRow], accuracies: Sequence[Accuracy], ranks: int) -> bytes:
    """Return all tables, and the time of every repetition, as HDF5."""
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        study = plan.study
        file.attrs.update({"study": study.study, "ranks": ranks, "time": study.time, "repeat": study.repeat})
        if study.beside is not None:
            file.attrs["beside"] = json.dumps(study.beside.model_dump(mode="json"), ensure_ascii=False)
        fill(file.create_group("runs"), run_columns(plan, rows, accuracies), run_units(accuracies))
        longest = max(len(row.times) for row in rows)
        times = np.full((len(rows), longest), np.nan)
        for row, entry in zip(rows, times, strict=True):
            entry[: len(row.times)] = row.times
        file["times"] = times
        file["times"].attrs["unit"] = "s"
        for accuracy in accuracies:
            group = file.create_group(f"quantities/{accuracy.name}")
            group.attrs["unit"] = accuracy.unit
            references = [r if isinstance(r, ReferenceValue) else None for r in accuracy.references]
            group["reference"] = [np.nan if r is None else r.value for r in references]
            group["reference"].attrs["origin"] = str(references[0].origin if references[0] else accuracy.refusal)
            group.create_group("orders").attrs.update(accuracy.fitted)
            fill(group.create_group("points"), point_columns(plan, accuracy), point_units(accuracy))
    return content.getvalue()
