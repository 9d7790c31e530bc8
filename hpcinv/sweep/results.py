"""What a store has of the cases of a sweep."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.batch.ledger.ledger import Ledger
    from hpcinv.batch.ledger.record import CaseRecord
    from hpcinv.sweep.plan import SweepPlan

_PROVENANCE = ("job", "fingerprint", "versions", "machine")
_LOOKED_AT = ("machine", "mesh", "quantities", "sensitivities", "peak_memory")


def results(plan: SweepPlan, ledger: Ledger, known: Mapping[str, CaseRecord] | None = None) -> dict[str, CaseRecord]:
    """The records of finished cases by key, in the order of the sweep, with those of their numbers that tables show.

    Args:
        known: what an earlier look has found: those who have converged are not read again.
    """
    before = {key: record for key, record in (known or {}).items() if record.converged}
    states = ledger.states(dict.fromkeys(case.key for case in plan.cases))
    found = {}
    for key, state in states.items():
        if state.name == "finished":
            record = before.get(key) or ledger.record(key)
            if record is not None:
                found[key] = record if key in before else _short(record)
    return found


def provenance(plan: SweepPlan, ledger: Ledger) -> Iterator[str]:
    """Of each case in the order of the sweep, as JSON: job, fingerprint, versions and machine, as far as there are."""
    for case in plan.cases:
        record = ledger.record(case.key)
        statistics = {} if record is None else record.statistics
        yield json.dumps({key: statistics[key] for key in _PROVENANCE if key in statistics}, ensure_ascii=False)


def _short(record: CaseRecord) -> CaseRecord:
    """Without what would fill the memory for thousands of cases: every iteration of every solve."""
    statistics: dict[str, Any] = {key: record.statistics[key] for key in _LOOKED_AT if key in record.statistics}
    if solutions := record.statistics.get("solutions"):
        counts = ("factorizations", "newton_iterations")
        statistics["solutions"] = [{key: solution[key] for key in counts} for solution in solutions]
    if certificate := record.statistics.get("certificate"):
        statistics["certificate"] = {key: certificate[key] for key in ("verdict", "estimate")}
    # The message of an error has numbers of its own case; the summary's diagnosis is the same for all like it.
    return replace(record, status=record.statistics.get("status", record.status), statistics=statistics)
