"""Rows of a study's table: values and costs of each run."""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hpcinv.base.parallel.timings import SOLVER
from hpcinv.base.quantity.keys import look_up
from hpcinv.job.mesh_generators import resolution_of
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.study.executions import Executions
from hpcinv.studies.study.study_plan import Run, RunPlace, StudyPlan
from hpcinv.studies.study.study_spec import refines


@dataclass(frozen=True)
class StudyRow:
    """Values and costs of one run.

    Attributes:
        key: hash of its content, the same for equal runs.
        status: "converged", or the diagnosis.
        costs: by name, times as medians over the repetitions; ``None`` if unknown.
        times: seconds of each repetition that is not discarded.
        certificate: its verdict; empty without certificate.
        estimates: estimated error of each value (corrected less computed), where the certificate has one.
        geometry_error: whether that is "included" in the estimates or "left out"; empty without estimates.
        size: size of the cells in any unit, ``None`` if more than the mesh varies.
    """

    place: RunPlace
    key: str
    status: str
    costs: Mapping[str, float | None]
    times: tuple[float, ...]
    values: Mapping[str, float | None]
    certificate: str
    estimates: Mapping[str, float | None]
    size: float | None
    geometry_error: str = ""

    @property
    def converged(self) -> bool:
        return self.status == "converged"

    @property
    def time(self) -> float | None:
        return self.costs["time"]


def rows_of(executions: Executions) -> list[StudyRow]:
    """Return the rows of a study whose runs are all done, in the order of its plan."""
    plan = executions.plan
    proportional = {series.name: _proportional(plan, series.name) for series in plan.study.series}
    return [
        _row(plan, run, executions.key(i), executions.records(i), proportional[run.place.series])
        for i, run in enumerate(plan.runs)
    ]


def _seconds(records: Sequence[CaseRecord]) -> dict[str, list[float]]:
    """Return the times of the runs that converged, without those that compiled if there are others."""
    converged = [record for record in records if record.converged]
    timed = [record.statistics for record in converged if not record.compiled] or [r.statistics for r in converged]
    certified = [float(s["timings"]["total"]) - _phases(s, ("programs",)) for s in timed]
    return {
        "run": [whole - _phases(s, ("certificate",)) for whole, s in zip(certified, timed, strict=True)],
        "certified": certified,
        "solver": [_phases(s, SOLVER) for s in timed],
    }


def _row(plan: StudyPlan, run: Run, key: str, records: Sequence[CaseRecord], parameter: str | None) -> StudyRow:
    study, statistics_of_run = plan.study, records[0].statistics
    converged, seconds = records[0].converged, _seconds(records)
    costs: dict[str, float | None] = {
        name: statistics.median(values_there) if values_there else None for name, values_there in seconds.items()
    }
    costs |= {
        "time": costs[study.time],
        "programs": max((_phases(r.statistics, ("programs",)) for r in records if r.statistics), default=None),
        "factorizations": look_up(statistics_of_run, "solutions[].factorizations"),
        "newton_iterations": look_up(statistics_of_run, "solutions[].newton_iterations"),
        "unknowns": look_up(statistics_of_run, "mesh.unknowns"),
        "cells": look_up(statistics_of_run, "mesh.cells"),
        "memory": float(max(statistics_of_run["peak_memory"]["ranks"])) if statistics_of_run else None,
    }
    costs |= {name: look_up(statistics_of_run, cost) for name, cost in study.costs.items()}
    values = {name: look_up(statistics_of_run, k) if converged else None for name, k in plan.measured.items()}
    estimates = {name: look_up(statistics_of_run, f"certificate.estimate.{k}") for name, k in plan.measured.items()}
    size = _size(run, costs["cells"], parameter) if refines(run.place.varied) else None
    geometry = str(records[0].estimate.get("geometry", ""))
    times = tuple(seconds[study.time])
    return StudyRow(
        run.place, key, records[0].status, costs, times, values, records[0].verdict, estimates, size, geometry
    )


def _phases(statistics: Mapping[str, Any], names: Sequence[str]) -> float:
    phases = statistics["timings"]["phases"]
    return float(sum(phases[name]["max"] for name in names if name in phases))


def _proportional(plan: StudyPlan, series: str) -> str | None:
    """Return the mesh parameter that varies; if several do, the first one, if they are proportional; else ``None``."""
    prefix = "mesh.parameters."
    runs = [run for run in plan.runs if run.place.series == series and run.place.case == 0]
    names = [key.removeprefix(prefix) for key in runs[0].place.varied if key.startswith(prefix)]
    sizes = np.array([[_parameter_size(run, name) for run in runs] for name in names], dtype=np.float64)  # None: NaN
    if not names or np.isnan(sizes).any():
        return None
    coarsening = sizes / sizes[:, -1:]
    return names[0] if np.isclose(coarsening, coarsening[0], rtol=1e-9, atol=0).all() else None


def _parameter_size(run: Run, name: str) -> float | None:
    """Return the size of the cells by a parameter that its generator annotates as a size or as divisions."""
    mesh = run.job.mesh
    resolution = resolution_of(run.job.resolve(mesh.file), mesh.parameters)
    return resolution.sizes.get(name, 1 / resolution.divisions[name] if name in resolution.divisions else None)


def _size(run: Run, cells: float | None, parameter: str | None) -> float | None:
    if parameter is not None:
        return _parameter_size(run, parameter)
    return cells ** (-1 / 3) if cells else None
