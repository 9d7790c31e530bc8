"""Run of a study: executions, tables and diagrams."""

import contextlib
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from hpcinv.base.parallel.code_cache import missing_count
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.parallel.signals import StopRequest
from hpcinv.driver import run
from hpcinv.errors import HpcinvError, Interrupted, JobError, SolveError
from hpcinv.job.job import Job
from hpcinv.mesh import build_body
from hpcinv.output.progress import SilentProgress
from hpcinv.solver.workspace import collect_garbage
from hpcinv.studies.batch.conduct import conduct
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.ledger import Ledger, ledger_of
from hpcinv.studies.batch.tables import as_csv
from hpcinv.studies.batch.task import Batch, BatchTask, Pause, Runner
from hpcinv.studies.study.directory import STORE, StudyDirectory
from hpcinv.studies.study.executions import RETRY, Executions
from hpcinv.studies.study.findings import Accuracy, findings
from hpcinv.studies.study.result_rows import StudyRow, rows_of
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


@dataclass(frozen=True)
class StudyTask(BatchTask):
    """One execution of a run; ``number`` of the ``total`` that are known to be needed."""

    number: int
    total: int


class StudySchedule:
    """Schedule of the executions of a study: all first ones, then all second ones, …; on the first rank."""

    def __init__(self, plan: StudyPlan, ledger: Ledger, _begin: float, ranks: int) -> None:
        self.executions = Executions(plan, ledger, ranks)

    def next(self) -> StudyTask | Pause | None:
        """Claim an execution; ``None`` if all are finished."""
        known = self.executions
        known.read()
        for number, i, job in (open_ones := known.open_ones()):
            if (claim := known.ledger.claim(known.execution_key(i, number))) is not None:
                done, total = known.count()
                return StudyTask(known.plan.runs[i].place.title, job, claim, done + 1, total)
        return Pause.WAIT if open_ones else None  # other allocations hold the rest

    def report(self, task: StudyTask, record: CaseRecord) -> str:
        line = f"[{task.number}/{task.total}] {task.title}: "
        if not record.converged:
            return line + record.status
        seconds = record.statistics["timings"]["total"]
        return line + f"{seconds:.2f} s" + (", not counted: programs had to be made" if record.compiled else "")


class StudyRunner(Runner[StudyTask]):
    """Executes runs on all ranks of ``comm``; writes no files."""

    def __init__(self, comm: MPI.Intracomm) -> None:
        self.comm = comm
        self._is_first = True

    def run(self, task: StudyTask, progress: SilentProgress, stop_asked: Callable[[], bool]) -> dict[str, Any]:
        if self._is_first:
            _load_gmsh(task.job, self.comm)
            self._is_first = False
        _reset_peak_memory()
        count_before = missing_count()
        run(task.job, self.comm, progress=progress, stop_asked=stop_asked)
        return {"compiled": self.comm.allreduce(missing_count() > count_before, op=MPI.LOR)}

    def clear(self) -> None:
        collect_garbage(self.comm)


def study_batch(plan: StudyPlan, directory: Path) -> Batch:
    """Return the executions of the runs of a study in a directory."""
    return Batch(directory / STORE, plan.study.limit, RETRY, partial(StudySchedule, plan), StudyRunner)


def _load_gmsh(job: Job, comm: MPI.Intracomm) -> None:
    """Make a mesh, so that loading gmsh does not count in the time of the first run."""
    with contextlib.suppress(HpcinvError):
        build_body(job.mesh, job.regions, comm, resolve=job.resolve)


def _reset_peak_memory() -> None:
    """Reset the peak memory of this process that the system measures (Linux only)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
