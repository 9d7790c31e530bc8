"""Outcomes of finished cases: what a status and a forecast need of their records, a few numbers and texts each."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from hpcinv.studies.batch.ledger.case_record import CaseRecord


class Outcome(NamedTuple):
    """Outcome of a finished case.

    Attributes:
        converged: whether it has a solution.
        diagnosis: the status without the numbers of the case.
        verdict: of its certificate; empty without one.
        seconds: wall time of the case.
        unknowns: number of unknowns; ``None`` if it is not known.
        start, by_series: as of the record.
    """

    converged: bool
    diagnosis: str
    verdict: str
    seconds: float
    unknowns: int | None
    start: str
    by_series: bool


def outcome_of(record: CaseRecord) -> Outcome:
    """Return the outcome of a case with a record, whole or brief."""
    return Outcome(
        record.converged,
        record.diagnosis,
        record.verdict,
        record.seconds,
        (record.statistics.get("mesh") or {}).get("unknowns"),
        record.start,
        record.by_series,
    )


def outcomes_of(records: Iterable[tuple[str, CaseRecord]]) -> dict[str, Outcome]:
    """Return outcomes by key; the records are not kept."""
    return {key: outcome_of(record) for key, record in records}
