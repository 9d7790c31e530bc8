"""Findings of a study: errors of each measured quantity, statistics over the cases, and the Pareto front."""

import itertools
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from hpcinv.studies.batch.tables import unit_of
from hpcinv.studies.study.references import ReferenceValue, find_reference, fitted_order, orders
from hpcinv.studies.study.result_rows import StudyRow
from hpcinv.studies.study.study_plan import StudyPlan


@dataclass(frozen=True)
class StepStatistics:
    """Statistics of one step of a series over all cases: a point in the diagrams.

    Attributes:
        errors: of the cases that have one.
        statistics: columns of the table: of the errors (``sd`` of a sample), averages of the costs of the cases
            that converged, the ``ratio`` of time to the base series for the cases that converged in both, and
            the number of ``failed`` cases; ``None`` if unknown.
        promised: average size of the errors that certificates estimate, ``None`` without any.
    """

    series: str
    step: int
    label: str
    errors: tuple[float, ...]
    statistics: Mapping[str, float | None]
    promised: float | None = None
    is_on_front: bool = False

    @property
    def average(self) -> float | None:
        return self.statistics["average"]

    @property
    def time(self) -> float | None:
        return self.statistics["time"]


@dataclass(frozen=True)
class Accuracy:
    """Errors and orders of one measured quantity.

    Attributes:
        references: reference value of each case, or the reason why there is none.
        errors: error of each row, or ``None``.
        orders: order of convergence from the row before to each row, or ``None``.
        effectivities: ratio of the estimated to the true error of each row, or ``None``.
        fitted: order of each series along which the mesh is refined, if there is one case.
    """

    name: str
    unit: str
    references: tuple[ReferenceValue | str, ...]
    errors: tuple[float | None, ...]
    orders: tuple[float | None, ...]
    effectivities: tuple[float | None, ...]
    fitted: Mapping[str, float]
    points: tuple[StepStatistics, ...]

    @property
    def refusal(self) -> str | None:
        """The reason why a case has no reference; ``None`` if all have one."""
        return next((r for r in self.references if isinstance(r, str)), None)

    def geometry_note(self, rows: Sequence[StudyRow]) -> str:
        """Return a sentence if estimates leave out the error of the geometry, which true errors have; else nothing."""
        pairs = zip(rows, self.effectivities, strict=True)
        count = sum(effectivity is not None and row.geometry_error == "left out" for row, effectivity in pairs)
        if not count:
            return ""
        return (
            f"Effectivities of {self.name} do not judge the estimate in {count} of {len(rows)} runs,"
            " whose meshes differ in geometry."
        )

    def front(self) -> str:
        """Return the titles of the points on the Pareto front, from fast to accurate; empty without points."""
        front_points = [point for point in self.points if point.is_on_front]
        best = sorted(front_points, key=lambda point: point.time or 0.0)
        return "; ".join(", ".join(filter(None, (point.series, point.label))) for point in best)

    def point_of(self, row: StudyRow) -> StepStatistics:
        return next(p for p in self.points if (p.series, p.step) == (row.place.series, row.place.step))


def findings(plan: StudyPlan, rows: Sequence[StudyRow]) -> list[Accuracy]:
    """Return errors and orders of each measured quantity in the rows."""
    return [accuracy(plan, rows, name, unit_of(key, plan.runs[0].job)) for name, key in plan.measured.items()]


def accuracy(plan: StudyPlan, rows: Sequence[StudyRow], name: str, unit: str) -> Accuracy:
    """Return errors and orders of one quantity in the rows."""
    case_groups = itertools.groupby(rows, key=lambda row: row.place.case)  # the rows of a case follow each other
    references = tuple(_reference(plan, [*case_rows], name) for _, case_rows in case_groups)
    errors = [_error(references[row.place.case], row, name) for row in rows]
    groups: dict[tuple[str, int], list[int]] = {}
    for i, row in enumerate(rows):
        groups.setdefault((row.place.series, row.place.case), []).append(i)
    observed: list[float | None] = [None] * len(rows)
    fitted = {}
    for (series, _), members in groups.items():
        sizes = [size for i in members if (size := rows[i].size) is not None]
        if len(sizes) == len(members):
            errors_of_series = [errors[i] for i in members]
            for i, order in zip(members, orders(sizes, errors_of_series), strict=True):
                observed[i] = order
            if plan.cases == 1 and (order := fitted_order(sizes, errors_of_series)) is not None:
                fitted[series] = order
    effectivities = tuple(_effectivity(references[row.place.case], row, name) for row in rows)
    points = _points(plan, rows, errors, name)
    return Accuracy(name, unit, references, tuple(errors), tuple(observed), effectivities, fitted, points)


def _reference(plan: StudyPlan, rows: Sequence[StudyRow], name: str) -> ReferenceValue | str:
    try:
        return find_reference(plan.study.reference_of(name), rows, name)
    except ValueError as error:
        return str(error)


def _error(reference: ReferenceValue | str, row: StudyRow, name: str) -> float | None:
    return None if isinstance(reference, str) else reference.error_of(row, name)


def _effectivity(reference: ReferenceValue | str, row: StudyRow, name: str) -> float | None:
    estimate, value = row.estimates[name], row.values[name]
    if isinstance(reference, str) or estimate is None or value is None or not reference.error_of(row, name):
        return None
    return estimate / (reference.value - value)


def _points(
    plan: StudyPlan, rows: Sequence[StudyRow], errors: Sequence[float | None], measured: str
) -> tuple[StepStatistics, ...]:
    members: dict[tuple[str, int], list[int]] = {}
    for i, row in enumerate(rows):
        members.setdefault((row.place.series, row.place.step), []).append(i)
    points = []
    for (series, step), numbers in members.items():
        those = [rows[i] for i in numbers]
        base = plan.study.series_called(series).base
        others = [] if base is None else members.get((base, step), members[base, 0])
        known = tuple(e for i in numbers if (e := errors[i]) is not None)
        ratio = None if base is None else _ratio(those, [rows[i] for i in others])
        figures = _figures(those, known) | {"ratio": ratio}
        estimates = (row.estimates[measured] for row in those if row.converged)
        promised = _average([abs(e) for e in estimates if e is not None])
        points.append(StepStatistics(series, step, those[0].place.label, known, figures, promised))
    best = front([(point.time, point.average) for point in points])
    return tuple(replace(point, is_on_front=is_best) for point, is_best in zip(points, best, strict=True))


def _figures(rows: Sequence[StudyRow], errors: Sequence[float]) -> dict[str, float | None]:
    """Return statistics of known errors, mean costs of converged runs, and the number of others."""
    converged = [row for row in rows if row.converged]
    return {
        "average": _average(errors),
        "sd": statistics.stdev(errors) if len(errors) > 1 else None,
        "minimum": min(errors, default=None),
        "maximum": max(errors, default=None),
        **{name: _average([c for row in converged if (c := row.costs[name]) is not None]) for name in rows[0].costs},
        "failed": len(rows) - len(converged),
    }


def front(points: Sequence[tuple[float | None, float | None]]) -> list[bool]:
    """Return which points (cost, error) are on the Pareto front.

    No other point is less in one and at most equal in the other. A point with a ``None`` is not on the front.
    """
    known = [(cost, error) for cost, error in points if cost is not None and error is not None]
    return [
        cost is not None
        and error is not None
        and not any(c <= cost and e <= error and (c, e) != (cost, error) for c, e in known)
        for cost, error in points
    ]


def _ratio(rows: Sequence[StudyRow], base: Sequence[StudyRow]) -> float | None:
    """Return the time of the cases that have one in both series, over the base series'."""
    pairs = [(a.time, b.time) for a, b in zip(rows, base, strict=True) if a.time and b.time]
    return math.fsum(a for a, _ in pairs) / math.fsum(b for _, b in pairs) if pairs else None


def _average(values: Sequence[float]) -> float | None:
    return math.fsum(values) / len(values) if values else None
