"""Reference values of a study: a closed form, the finest run, or Richardson's extrapolation."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from hpcinv.studies.study.convergence import richardson
from hpcinv.studies.study.result_rows import StudyRow
from hpcinv.studies.study.study_spec import LEAST_MESHES, Reference


@dataclass(frozen=True)
class ReferenceValue:
    """A reference value, its origin, and the key of the run that has it, if it is the value of a run."""

    value: float
    origin: str
    key: str | None = None

    def error_of(self, row: StudyRow, name: str) -> float | None:
        """Return the error of a run's value; ``None`` for the run that is the reference."""
        value = row.values[name]
        return None if value is None or row.key == self.key else abs(value - self.value)


def _candidates(reference: Reference, rows: Sequence[StudyRow], name: str) -> list[StudyRow]:
    """Return the rows whose value of a quantity may be the reference."""
    known = [row for row in rows if row.values[name] is not None and reference.series in (None, row.place.series)]
    if reference.kind != "richardson" or reference.series is not None:
        return known
    counts = Counter(row.place.series for row in known if row.size is not None)  # of the series that refine the mesh
    return [row for row in known if counts[row.place.series] >= LEAST_MESHES] or known


def find_reference(reference: Reference, rows: Sequence[StudyRow], name: str) -> ReferenceValue:
    """Return the reference of one quantity among the rows of one case.

    Raises:
        ValueError: there is none; the message has reason and remedy.
    """
    if reference.value is not None:
        return ReferenceValue(reference.value, reference.kind)
    known = _candidates(reference, rows, name)
    if not known:
        raise ValueError("no run has a value that can be the reference")
    # Of equally fine runs the last one is taken, since a series of tolerances ends with the strictest.
    finest = max(reversed(known), key=lambda row: row.costs["unknowns"] or 0.0)
    if reference.kind == "finest":
        value = finest.values[name]
        assert value is not None
        return ReferenceValue(value, f"finest run: {finest.place.title}", finest.key)
    return _extrapolated([row for row in known if row.place.series == finest.place.series], name)


def _extrapolated(rows: Sequence[StudyRow], name: str) -> ReferenceValue:
    series = rows[0].place.series
    instead = "; take finest or a value instead, or another series: {richardson: NAME}"
    rows_by_size = {row.size: row for row in rows if row.size is not None}
    if len(rows_by_size) == 0:
        raise ValueError(f"richardson needs a series along which nothing but the mesh varies, not '{series}'{instead}")
    three = [rows_by_size[size] for size in sorted(rows_by_size, reverse=True)[-3:]]
    if len(three) < LEAST_MESHES:
        raise ValueError(f"richardson needs three meshes, and series '{series}' has {len(three)}{instead}")
    values = [row.values[name] or 0.0 for row in three]
    try:
        limit, order = richardson([row.size or 0.0 for row in three], values)
    except ValueError as error:
        shown = ", ".join(f"{value:.9g}" for value in values)
        raise ValueError(f"richardson: the values of series '{series}', {shown}, {error}{instead}") from None
    return ReferenceValue(limit, f"Richardson's extrapolation of {series}, observed order {order:.2f}")
