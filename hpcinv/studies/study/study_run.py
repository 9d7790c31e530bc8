"""Run of a study: executions, tables and diagrams."""

import re
from functools import partial
from pathlib import Path

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.parallel.signals import StopRequest
from hpcinv.errors import Interrupted, JobError, SolveError
from hpcinv.studies.batch.conduct import conduct
from hpcinv.studies.batch.ledger.ledger import ledger_of
from hpcinv.studies.batch.tables import as_csv
from hpcinv.studies.study.directory import StudyDirectory
from hpcinv.studies.study.executions import Executions
from hpcinv.studies.study.findings import Accuracy, findings
from hpcinv.studies.study.result_rows import StudyRow, rows_of
from hpcinv.studies.study.study_batch import study_batch
from hpcinv.studies.study.study_plan import StudyPlan
from hpcinv.studies.study.study_report import show
from hpcinv.studies.study.study_tables import as_hdf5, point_columns, point_units, run_columns, run_units
from hpcinv.studies.study.work_precision import case_diagrams, work_precision

SECONDS = {
    "run": "whole run without its certificate, and without making programs",
    "certified": "whole run with its certificate",
    "solver": "Newton's method",
}


def run_study(
    plan: StudyPlan,
    comm: MPI.Intracomm,
    *,
    directory: Path,
    retry_failed: bool,
    stop: StopRequest,
) -> None:
    """Run the open executions of the study in ``directory``, then write and show its results; collective.

    Several allocations may do so at the same time; each ends when all runs are done.

    Args:
        retry_failed: whether runs that have failed before are tried again.

    Raises:
        OutputError: the directory is not this study's, or cannot be written.
        Interrupted: a signal asked to stop; what was done is kept.
        SolveError: not one run converged.
        JobError: something measured is not there, or has no reference.
    """
    batch = study_batch(plan, directory)
    note = partial(print, flush=True)

    def known() -> Executions:
        return Executions(plan, ledger_of(batch.store), comm.size)

    def begin() -> None:
        StudyDirectory(directory, plan.study.study).set_ranks(comm.size)
        executions = known()
        history = f"; {done} executions were done before" if (done := executions.count()[0]) else ""
        if retry_failed:
            history += f", {executions.retry()} of them failed and are open again"
        ranks = f"{comm.size} rank{'s' if comm.size > 1 else ''}"
        note(f"{plan.study.study}: {len(plan.runs)} runs, {ranks}; results in {directory}{history}")

    on_root(comm, begin)
    try:
        conduct(batch, comm, ranks_per_case=comm.size, isolated=False, note=note, stop=stop)
    except Interrupted:
        done, total = on_root(comm, lambda: known().count())
        raise Interrupted(
            f"stopped by a signal; {done} of {total} runs are done and kept", "The same command continues."
        ) from None
    on_root(comm, lambda: conclude(known(), StudyDirectory(directory, plan.study.study)))


def conclude(executions: Executions, directory: StudyDirectory) -> None:
    """Write and show the tables and diagrams of a study whose runs are all done.

    Raises:
        SolveError: not one run converged.
        JobError: something measured is not there, or has no reference; all else is written nevertheless.
    """
    plan = executions.plan
    rows = rows_of(executions)
    accuracies = findings(plan, rows)
    for name, content in _files(plan, rows, accuracies, executions.ranks).items():
        directory.write(name, content)
    show(plan, rows, accuracies)
    if not any(row.converged for row in rows):
        raise SolveError(f"{plan.path}: not one of the {len(rows)} runs converged; the first: {rows[0].status}")
    problems = []
    for a in accuracies:
        if all(row.values[a.name] is None for row in rows):
            problems.append(f"{plan.path}: measure: the summary has no number at {plan.measured[a.name]}")
        elif a.refusal is not None:
            problems.append(f"{plan.path}: reference.{a.name}: {a.refusal}")
    if problems:
        raise JobError(*problems)


def _files(plan: StudyPlan, rows: list[StudyRow], accuracies: list[Accuracy], ranks: int) -> dict[str, str | bytes]:
    files: dict[str, str | bytes] = {
        "table.csv": as_csv(run_columns(plan, rows, accuracies), run_units(accuracies)),
        "table.h5": as_hdf5(plan, rows, accuracies, ranks),
    }
    if plan.cases > 1:
        files |= {f"{_stem(a)}-statistics.csv": as_csv(point_columns(plan, a), point_units(a)) for a in accuracies}
    return files | diagrams(plan, rows, accuracies, ranks)


def diagrams(plan: StudyPlan, rows: list[StudyRow], accuracies: list[Accuracy], ranks: int) -> dict[str, bytes]:
    """Return the diagrams of a study by the names of their files, as PNG and SVG."""
    files: dict[str, bytes] = {}
    study = plan.study
    most = max(len(row.times) for row in rows)
    seconds = f"{SECONDS[study.time]}, {ranks} rank{'s' if ranks > 1 else ''}, median of {most}"
    varied = {series.name: ", ".join(key.rpartition(".")[2] for key in series.vary) for series in study.series}
    for a in accuracies:
        stem = _stem(a)
        files |= {f"{stem}.{form}": data for form, data in work_precision(study, a, seconds, varied).items()}
        if plan.cases > 1:
            files |= {f"{stem}-cases.{form}": data for form, data in case_diagrams(study.study, a, rows).items()}
    return files


def _stem(accuracy: Accuracy) -> str:
    return re.sub(r"[\[\]]+", "-", accuracy.name).strip("-")
