"""Diagrams of a sweep: a quantity over one or two parameters, by branches, or a map of failures."""

import math
import statistics
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.errors import JobError
from hpcinv.pages.pictures.figures import as_files, new_figure
from hpcinv.studies.batch.diagram_drawing import DiagramSeries, Scale, draw_lines, draw_maps, draw_outcomes
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.specification import text_of
from hpcinv.studies.batch.tables import Columns
from hpcinv.studies.sweep.parameter_columns import log_uniform, sampled
from hpcinv.studies.sweep.sweep_plan import SweepPlan
from hpcinv.studies.sweep.table import TEXT, SweepTable, parameter_name, parameter_names

FAILURES = "failures"
"""name of the map of outcomes, instead of a quantity"""
MOST_PANELS = 6
"""largest number of maps in a diagram"""
MOST_LINES = 7
"""largest number of lines with different colours; beyond it lines share the colour of their first parameter"""


def plot(
    plan: SweepPlan, records: Iterable[tuple[str, CaseRecord]], quantity: str, axes: Sequence[str]
) -> tuple[dict[str, bytes], list[str]]:
    """Return the diagram of a quantity over one or two parameters as files by format, and what it leaves out.

    Args:
        quantity: a column of the table, or ``failures``.
        axes: one or two columns of parameters; ``failures`` needs two.

    Raises:
        JobError: there is no such column, or it has no values yet.
    """
    table, known_units = SweepTable(plan, records).in_units_of_the_job()
    _check(plan, table, quantity, axes)
    rows = _finished_rows(plan, table, quantity, axes)
    places = [_positions([table[name][i] for i in rows]) for name in axes]
    scales = [
        Scale(_label(name, known_units), _is_logarithmic(plan, name, *place), place[1])
        for name, place in zip(axes, places, strict=True)
    ]
    values = [math.nan] * len(rows)
    if quantity != FAILURES:
        values = [math.nan if table[quantity][i] is None else float(table[quantity][i]) for i in rows]
    points = zip(*(positions for positions, _ in places), strict=True)
    statuses = (table["status"][i] for i in rows)
    series = _series(plan, table, axes, dict(zip(rows, zip(points, values, statuses, strict=True), strict=True)))
    left_out = [*_left_out(plan, table, quantity, axes)]
    if len(axes) == 2 and (more := len(series) - MOST_PANELS) > 0:
        left_out.append(f"{more} of {len(series)} combinations of the other parameters; each takes a panel")
        series = series[:MOST_PANELS]
    title = "\n".join(
        [f"{plan.sweep.sweep}: {quantity}", *(textwrap.fill(f"left out: {text}", 90) for text in left_out)]
    )
    return _drawn(title, quantity, series, scales, _label(quantity, known_units)), left_out


def _finished_rows(plan: SweepPlan, table: Columns, quantity: str, axes: Sequence[str]) -> list[int]:
    """Return the rows of the finished cases that have the parameters."""
    finished = [i for i, status in enumerate(table["status"]) if status != "open"]
    rows = [i for i in finished if all(table[name][i] not in (None, "") for name in axes)]
    if not rows:
        raise JobError(f"{plan.path}: no case with {' and '.join(axes)} is finished", "Begin with 'sweep run'.")
    if quantity != FAILURES and all(table[quantity][i] is None for i in rows):
        raise JobError(f"{plan.path}: no finished case has a value of {quantity}", "Name another quantity.")
    return rows


def _is_logarithmic(plan: SweepPlan, name: str, positions: Sequence[float], ticks: Sequence[str]) -> bool:
    is_asked = name in {parameter_name(key) for key in log_uniform(plan)}
    return not ticks and min(positions) > 0 and (is_asked or is_even_in_log(positions))


def _reason(table: Columns, row: int, quantity: str, axes: Sequence[str]) -> str:
    """Return why a diagram cannot show a case; empty if it can."""
    status = table["status"][row]
    if status == "open":
        return "not finished"
    missing = [name for name in axes if table[name][row] in (None, "")]
    if quantity != FAILURES and status == "converged" and table[quantity][row] is None:
        missing.append(quantity)
    return f"without {missing[0]}" if missing else ""


def _left_out(plan: SweepPlan, table: Columns, quantity: str, axes: Sequence[str]) -> Iterator[str]:
    """Yield lines on cases that a diagram cannot show: their number, the reason, and their branches."""
    cases_by_reason: dict[str, list[int]] = {}
    for i in range(len(table["status"])):
        if reason := _reason(table, i, quantity, axes):
            cases_by_reason.setdefault(reason, []).append(i)
    for reason in sorted(
        cases_by_reason, key=["not finished", *(f"without {name}" for name in (*axes, quantity))].index
    ):
        cases = cases_by_reason[reason]
        labels = dict.fromkeys(str(table[name][i]) for i in cases for name in plan.sweep.branches if table[name][i])
        where = f" ({', '.join(labels)})" if labels else ""
        yield f"{len(cases)} of {len(plan.cases)} cases, {reason}{where}"


def _series(
    plan: SweepPlan, table: Columns, axes: Sequence[str], cases: Mapping[int, tuple[tuple[float, ...], float, str]]
) -> list[DiagramSeries]:
    """Return series of cases with the same values of all other parameters, except sampled ones.

    The points of samples are not joined.

    Args:
        cases: place, value and status by row.
    """
    drawn = {parameter_name(key) for key in sampled(plan)}
    names = [name for name in parameter_names(plan) if name not in axes and name not in drawn]
    others = [name for name in names if len({table[name][i] for i in cases}) > 1]
    is_sample = any(table[name][i] is not None for name in drawn for i in cases)
    is_text = any(isinstance(table[axes[0]][i], str) for i in cases)
    groups: dict[tuple[Any, ...], list[int]] = {}
    for i in cases:
        groups.setdefault(tuple(table[name][i] for name in others), []).append(i)
    series = []
    for (label, colour), rows in zip(_labels(others, groups, len(axes)), groups.values(), strict=True):
        places, values, statuses = zip(*(cases[i] for i in rows), strict=True)
        series.append(DiagramSeries(label, colour, places, values, statuses, is_curve=not is_sample and not is_text))
    return series


def is_even_in_log(values: Sequence[float]) -> bool:
    """Return whether positive values span at least two decades, with the logarithm of their median near the middle."""
    low, high = min(values), max(values)
    if low <= 0 or high < 100 * low:
        return False
    off = math.log(statistics.median(set(values)) ** 2 / (low * high)) / 2
    return abs(off) < 0.25 * math.log(high / low)


def _check(plan: SweepPlan, table: Columns, quantity: str, axes: Sequence[str]) -> None:
    """Raise ``JobError`` unless the quantity and the parameters exist."""
    parameters = parameter_names(plan)
    problems = [
        f"there is no parameter '{name}'.{did_you_mean(name, parameters)}" for name in axes if name not in table
    ]
    if not 1 <= len(axes) <= 2 or len({*axes}) < len(axes):
        problems.append("a diagram is over one or two different parameters")
    elif quantity == FAILURES and len(axes) == 1:
        problems.append("the map of failures is over two parameters")
    numbers = table.keys() - {*parameters, "number", "key", *TEXT}
    if quantity not in {*numbers, FAILURES}:
        problems.append(f"there is no quantity '{quantity}'.{did_you_mean(quantity, {*numbers, FAILURES})}")
    if problems:
        raise JobError(*(f"{plan.path}: {problem}" for problem in problems))


def _positions(values: Sequence[Any]) -> tuple[list[float], tuple[str, ...]]:
    """Return numbers unchanged without texts, or texts as 0, 1, … in their order, with the distinct texts."""
    if not any(isinstance(value, str) for value in values):
        return [float(value) for value in values], ()
    ticks = tuple(dict.fromkeys(values))
    return [float(ticks.index(value)) for value in values], ticks


def _labels(others: list[str], groups: Mapping[tuple[Any, ...], Any], axes: int) -> list[tuple[str, int]]:
    """Return label and number of the style of each group."""

    def text(names: Sequence[str], values: Sequence[Any]) -> str:
        known = ((n, v) for n, v in zip(names, values, strict=True) if v not in (None, ""))
        return ", ".join(v if isinstance(v, str) else f"{n.rpartition('.')[2]} {text_of(v)}" for n, v in known)

    if axes == 2 or len(groups) <= MOST_LINES:
        return [(text(others, values), i) for i, values in enumerate(groups)]
    firsts = list(dict.fromkeys(values[0] for values in groups))
    return [(text(others[:1], values[:1]), firsts.index(values[0])) for values in groups]


def _label(name: str, known_units: Mapping[str, str]) -> str:
    return f"{name} / {known_units[name]}" if known_units.get(name) else name


def _drawn(title: str, quantity: str, series: list[DiagramSeries], scales: list[Scale], label: str) -> dict[str, bytes]:
    if len(scales) == 1:
        with new_figure(6.5, 4.5) as figure:
            axes = figure.add_subplot()
            draw_lines(axes, title, series, scales[0], Scale(label))
            if axes.get_legend_handles_labels()[0]:
                axes.legend()
            return as_files(figure)
    column_count, down = min(len(series), 3), math.ceil(len(series) / 3)
    both = (scales[0], scales[1])
    with new_figure(1.5 + 3.6 * column_count, 0.8 + 3.2 * down) as figure:
        if quantity == FAILURES:
            draw_outcomes(figure, title, series, both)
        else:
            values = [value for s in series for value in s.points(converged=True)[1]]
            draw_maps(figure, title, series, both, Scale(label, is_even_in_log(values)))
        return as_files(figure)
