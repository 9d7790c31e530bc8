"""Results of a sweep in its store: records, status and provenance of its cases."""

import json
from collections.abc import Iterator, Mapping

from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.ledger import Ledger
from hpcinv.studies.batch.status import BatchCase, Status, status
from hpcinv.studies.sweep.sweep_plan import SweepPlan

RETRY = "sweep retry --failed"
_PROVENANCE = ("job", "fingerprint", "versions", "machine")


def results(plan: SweepPlan, ledger: Ledger, known: Mapping[str, CaseRecord] | None = None) -> dict[str, CaseRecord]:
    """Return the records of finished cases by key, in the order of the sweep, with the numbers that tables show.

    Args:
        known: result of an earlier call; records of converged cases are not read again.
    """
    keys = dict.fromkeys(plan.cases.keys)
    kept = {key: record for key, record in (known or {}).items() if record.converged}
    kept |= dict(ledger.briefs(key for key in keys if key not in kept))
    return {key: kept[key] for key in keys if key in kept}


def status_of(plan: SweepPlan, ledger: Ledger, records: Mapping[str, CaseRecord]) -> Status:
    """Return the status of a sweep with the ``records`` of its finished cases."""
    failed = {key for key, record in records.items() if not record.converged}  # only their titles are shown
    cases = [
        BatchCase(key, plan.cases[place].title if key in failed else "", group)
        for place, (key, group) in enumerate(zip(plan.cases.keys, plan.cases.reuse_groups, strict=True))
    ]
    return status(plan.sweep.sweep, cases, ledger, records, retry=RETRY)


def series_line(records: Mapping[str, CaseRecord]) -> list[str]:
    """Return the line on cases that began with values of power series; empty without any."""
    starts = [record.start for record in records.values() if record.by_series]
    if not starts:
        return []
    return [f"  {len(set(starts)):,} power series gave the start of {len(starts):,} cases"]


def provenance(plan: SweepPlan, ledger: Ledger) -> Iterator[str]:
    """Yield job, fingerprint, versions and machine of each case as JSON, as far as they are known."""
    lines = {
        key: json.dumps({k: record.statistics[k] for k in _PROVENANCE if k in record.statistics}, ensure_ascii=False)
        for key, record in ledger.records(dict.fromkeys(plan.cases.keys))
    }
    for key in plan.cases.keys:
        yield lines.get(key, "{}")
