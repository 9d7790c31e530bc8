"""A study from its file to its tables and diagrams."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
from hpcinv.batch.tables import as_csv
from hpcinv.batch.units import unit_of
from hpcinv.errors import JobError, SolveError
from hpcinv.parallel.runtime import MPI, compilation_explained, on_root
from hpcinv.study.diagram import over_cases, work_precision
from hpcinv.study.execute import execute
from hpcinv.study.findings import Accuracy, accuracy
from hpcinv.study.report import show
from hpcinv.study.rows import Row, rows_of
from hpcinv.study.schedule import Schedule
from hpcinv.study.store import Store
from hpcinv.study.tables import as_hdf5, point_columns, point_units, run_columns, run_units

if TYPE_CHECKING:
    from hpcinv.study.plan import Plan

SECONDS = {"run": "whole run without compilation", "solver": "Newton's method"}


def conduct(
    plan: Plan,
    comm: MPI.Intracomm,
    *,
    directory: Path,
    note: Callable[[str], None],
    stop_asked: Callable[[], bool],
) -> None:
    """Run what the study in ``directory`` still lacks, and write and show what it has found; collective.

    Raises:
        OutputError: the directory is not this study's, or cannot be written.
        Interrupted: ``stop_asked`` was true on some rank; what was done is kept.
        SolveError: not one run converged.
        JobError: something measured is not there, or has no reference.
    """
    schedules: list[Schedule] = []

    def begin() -> str:
        schedules.append(Schedule(plan, Store(directory, plan.study.study), comm.size))
        reused = schedules[0].reused
        before = f"; {reused} executions were done before" if reused else ""
        ranks = f"{comm.size} rank{'s' if comm.size > 1 else ''}"
        return f"{plan.study.study}: {len(plan.runs)} runs, {ranks}; results in {directory}{before}"

    note(on_root(comm, begin))
    schedule = schedules[0] if schedules else None
    with compilation_explained(comm):
        execute(schedule, comm, note=note, stop_asked=stop_asked)

    def end() -> None:
        assert schedule is not None
        conclude(plan, schedule, comm.size)

    on_root(comm, end)


def conclude(plan: Plan, schedule: Schedule, ranks: int) -> None:
    """Write and show the tables and diagrams of a study whose runs are all done.

    Raises:
        SolveError: not one run converged.
        JobError: something measured is not there, or has no reference; all else is written nevertheless.
    """
    rows = rows_of(plan, schedule)
    units = {name: unit_of(key, plan.runs[0].job) for name, key in plan.measured.items()}
    found = [accuracy(plan, rows, name, unit) for name, unit in units.items()]
    for name, content in _files(plan, rows, found, ranks).items():
        schedule.store.write(name, content)
    show(plan, rows, found)
    if not any(row.converged for row in rows):
        raise SolveError(f"{plan.path}: not one of the {len(rows)} runs converged; the first: {rows[0].status}")
    problems = []
    for a in found:
        if all(row.values[a.name] is None for row in rows):
            problems.append(f"{plan.path}: measure: the summary has no number at {plan.measured[a.name]}")
        elif a.refusal is not None:
            problems.append(f"{plan.path}: reference.{a.name}: {a.refusal}")
    if problems:
        raise JobError(problems)


def _files(plan: Plan, rows: list[Row], found: list[Accuracy], ranks: int) -> dict[str, str | bytes]:
    """Contents by name."""
    files: dict[str, str | bytes] = {
        "table.csv": as_csv(run_columns(plan, rows, found), run_units(found)),
        "table.h5": as_hdf5(plan, rows, found, ranks),
    }
    study = plan.study
    most = max(len(row.times) for row in rows)
    seconds = f"{SECONDS[study.time]}, {ranks} rank{'s' if ranks > 1 else ''}, median of {most}"
    varied = {ladder.name: ", ".join(key.rpartition(".")[2] for key in ladder.vary) for ladder in study.ladders}
    for a in found:
        stem = re.sub(r"[\[\]]+", "-", a.name).strip("-")
        files |= {f"{stem}.{form}": data for form, data in work_precision(study.study, a, seconds, varied).items()}
        if plan.cases > 1:
            files[f"{stem}-statistics.csv"] = as_csv(point_columns(plan, a), point_units(a))
            files |= {f"{stem}-cases.{form}": data for form, data in over_cases(study.study, a, rows).items()}
    return files
