"""Report of a study: work-precision diagrams, and a table of its runs."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from hpcinv.errors import OutputError
from hpcinv.pages.reports.cases_page import cases_page, outcome_of
from hpcinv.pages.reports.page import write_page
from hpcinv.studies.study.executions import Executions
from hpcinv.studies.study.findings import Accuracy, findings
from hpcinv.studies.study.references import ReferenceValue
from hpcinv.studies.study.result_rows import StudyRow, rows_of
from hpcinv.studies.study.study_run import diagrams
from hpcinv.studies.study.study_tables import run_columns, run_units


def write_study_report(executions: Executions, path: Path) -> Path:
    """Write the report of a study whose runs are all done; return the file.

    Raises:
        OutputError: runs are open, or the file cannot be written.
    """
    plan = executions.plan
    done, total = executions.count()
    if done < total:
        raise OutputError(
            f"{plan.path}: {done} of {total} runs are done", f"Finish them: python -m hpcinv study {plan.path}"
        )
    rows = rows_of(executions)
    accuracies = findings(plan, rows)
    pictures = [
        (name.removesuffix(".png").replace("-", " "), data)
        for name, data in diagrams(plan, rows, accuracies, executions.ranks).items()
        if name.endswith(".png")
    ]
    columns = {"number": list(range(1, len(rows) + 1))} | run_columns(plan, rows, accuracies)
    notes = [note for accuracy in accuracies for note in _notes(accuracy, rows)]
    converged = sum(row.converged for row in rows)
    numbers = [name for name in columns if name in ("unknowns", "time", *(accuracy.name for accuracy in accuracies))]
    errors = [name for name in columns if "error" in name and "estimated" not in name]
    page = cases_page(
        title=plan.study.study,
        finding=f"{converged} of {len(rows)} runs converged.",
        notes=notes,
        columns=columns,
        units=run_units(accuracies),
        parameters=numbers,
        results=errors,
        outcome=[outcome_of(converged=row.converged, verdict=row.certificate) for row in rows],
        diagrams=pictures,
    )
    write_page(path, page)
    return path


def _notes(accuracy: Accuracy, rows: Sequence[StudyRow]) -> Iterator[str]:
    """Yield sentences on the errors of a quantity."""
    reference = accuracy.references[0]
    if isinstance(reference, ReferenceValue):
        yield f"Errors of {accuracy.name} are against {reference.value:.10g} {accuracy.unit} ({reference.origin})."
    else:
        yield f"{accuracy.name} has no errors: {reference}."
    if note := accuracy.geometry_note(rows):
        yield note
    if front := accuracy.front():
        yield f"Pareto front of {accuracy.name}, from fast to accurate: {front}."
