"""Printed report of a study: a table for each quantity, with published numbers next to the study's."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

from rich.table import Table

from hpcinv.output.console import table_console, table_of_numbers
from hpcinv.studies.study.findings import Accuracy
from hpcinv.studies.study.references import ReferenceValue
from hpcinv.studies.study.result_rows import StudyRow
from hpcinv.studies.study.study_plan import StudyPlan
from hpcinv.studies.study.study_spec import STATISTICS
from hpcinv.studies.study.study_tables import relative


def show(plan: StudyPlan, rows: Sequence[StudyRow], accuracies: Sequence[Accuracy]) -> None:
    console = table_console(160)
    for accuracy in accuracies:
        console.print()
        console.print(_heading(plan, accuracy), soft_wrap=True)
        console.print(_case_table(plan, accuracy) if plan.cases > 1 else _run_table(rows, accuracy))
        for line in _notes(plan, rows, accuracy):
            console.print(line, soft_wrap=True)
    for line in not_refined(rows):
        console.print(line, soft_wrap=True)
    failed = [row for row in rows if not row.converged]
    for row in failed[:_MOST]:
        console.print(f"failed: {row.place.title}: {row.status}", soft_wrap=True)
    if len(failed) > _MOST:
        console.print(f"failed: {len(failed) - _MOST} more, in table.csv")


def not_refined(rows: Sequence[StudyRow]) -> Iterator[str]:
    """Yield a warning for each series of meshes whose number of cells does not grow from run to run."""
    cells: dict[str, list[float]] = {}
    for row in rows:
        if row.place.case == 0 and row.size is not None and (count := row.costs["cells"]) is not None:
            cells.setdefault(row.place.series, []).append(count)
    for series, counts in cells.items():
        if any(coarse >= fine for coarse, fine in pairwise(counts)):
            shown = ", ".join(f"{count:,.0f}" for count in counts)
            yield (
                f"warning: meshes of series '{series}' do not become finer ({shown} cells);"
                " order them from coarse to fine"
            )


_MOST = 20  # largest number of failures that are printed


def _heading(plan: StudyPlan, accuracy: Accuracy) -> str:
    reference, unit = accuracy.references[0], f" {accuracy.unit}" if accuracy.unit else ""
    text = f"{accuracy.name}{f' ({accuracy.unit})' if accuracy.unit else ''}: "
    if not isinstance(reference, ReferenceValue):
        return text + f"no errors: {reference}"
    if plan.cases > 1:
        return text + f"{plan.cases} cases, errors against {reference.origin.partition(':')[0]}"
    return text + f"errors against {reference.value:.10g}{unit} ({reference.origin})"


def _run_table(rows: Sequence[StudyRow], accuracy: Accuracy) -> Table:
    estimated = any(e is not None for e in accuracy.effectivities)
    extra = [name for name in rows[0].costs if name not in (*_COSTS, *_LEFT_OUT)]
    table = table_of_numbers(
        "series", "run", *_COSTS.values(), *extra, "value", "error", "relative", "order", texts=2, header_style="bold"
    )
    if estimated:
        table.add_column("effectivity", justify="right", no_wrap=True)
    table.add_column("front", justify="center")
    for i, row in enumerate(rows):
        error = accuracy.errors[i]
        cells = [row.place.series, row.place.label, *(_cost(name, row.costs[name]) for name in (*_COSTS, *extra))]
        cells += [_number(row.values[accuracy.name], ".10g"), _number(error, ".2e")]
        cells += [_number(relative(accuracy, row, error), ".1e"), _number(accuracy.orders[i], ".2f")]
        if estimated:
            effectivity = accuracy.effectivities[i]
            left_out = " (no geometry)" if row.geometry_error == "left out" and effectivity is not None else ""
            cells.append(_number(effectivity, ".2f") + left_out)
        table.add_row(*cells, "*" if accuracy.point_of(row).is_on_front else "")
    return table


def _case_table(plan: StudyPlan, accuracy: Accuracy) -> Table:
    published_numbers = plan.study.beside
    published = published_numbers.statistics.get(accuracy.name, {}) if published_numbers else {}
    extra = list(plan.study.costs)
    names = (*STATISTICS, *_COSTS, *extra, "ratio", "failed")
    table = table_of_numbers("series", "run", *(_COSTS.get(name, name) for name in names), texts=2, header_style="bold")
    for point in accuracy.points:
        table.add_row(point.series, point.label, *(_statistic(name, point.statistics[name]) for name in names))
        if point.series in published and point.step == 0:
            numbers = published[point.series]
            table.add_row("", "published", *(_statistic(name, numbers.get(name)) for name in names), style="italic")
    return table


def _notes(plan: StudyPlan, rows: Sequence[StudyRow], accuracy: Accuracy) -> Iterator[str]:
    if note := accuracy.geometry_note(rows):
        yield note
    if accuracy.fitted:
        orders = ", ".join(f"{series} {order:.2f}" for series, order in accuracy.fitted.items())
        yield f"orders of convergence (least squares): {orders}"
    if front := accuracy.front():
        yield f"Pareto front, from fast to accurate: {front}"
    if (published_numbers := plan.study.beside) is None:
        return
    reference = accuracy.references[0]
    for name, value in published_numbers.values.get(accuracy.name, {}).items():
        difference = ""
        if isinstance(reference, ReferenceValue) and reference.value:
            difference = f", {value / reference.value - 1:+.2%} from the reference here"
        yield f"published: {name} {value:.7g} {accuracy.unit}{difference}"
    if accuracy.name in published_numbers.values or accuracy.name in published_numbers.statistics:
        yield f"published numbers: {published_numbers.source}"


_COSTS = {
    "unknowns": "unknowns",
    "factorizations": "factorizations",
    "newton_iterations": "Newton",
    "memory": "memory",
    "time": "time",
}
_LEFT_OUT = ("run", "certified", "solver", "programs", "cells")


def _cost(name: str, value: float | None) -> str:
    if name == "memory":
        return _number(None if value is None else value / 1e6, ".0f", " MB")
    return _number(value, ".3g" if name == "time" else ".6g", " s" if name == "time" else "")


def _statistic(name: str, value: float | None) -> str:
    if name in STATISTICS:
        return _number(value, ".2e")
    return _number(value, ".2f") if name == "ratio" else _cost(name, value)


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "-" if value is None else f"{value:{form}}{unit}"
