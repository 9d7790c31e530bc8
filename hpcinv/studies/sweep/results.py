"""Results of a sweep in its store: records, status and provenance of its cases."""

import json
from collections.abc import Iterator, Mapping

from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.ledger import Ledger
from hpcinv.studies.batch.outcomes import Outcome, outcomes_of
from hpcinv.studies.batch.status import BatchCase, Status, status
from hpcinv.studies.sweep.sweep_plan import SweepPlan

RETRY = "sweep retry --failed"
_PROVENANCE = ("job", "fingerprint", "versions", "machine")


def results(plan: SweepPlan, ledger: Ledger) -> dict[str, CaseRecord]:
    """Return the records of finished cases by key, in the order of the sweep, with the numbers that tables show."""
    records = dict(finished(plan, ledger))
    return {key: records[key] for key in plan.cases.keys if key in records}


def finished(plan: SweepPlan, ledger: Ledger) -> Iterator[tuple[str, CaseRecord]]:
    """Yield key and brief record of each finished case, in any order."""
    return ledger.briefs(dict.fromkeys(plan.cases.keys))


def outcomes(plan: SweepPlan, ledger: Ledger, known: Mapping[str, Outcome] | None = None) -> dict[str, Outcome]:
    """Return the outcomes of finished cases by key, in the order of the sweep.

    Args:
        known: result of an earlier call; records of converged cases are not read again.
    """
    kept = {key: outcome for key, outcome in (known or {}).items() if outcome.converged}
    kept |= outcomes_of(ledger.briefs(key for key in dict.fromkeys(plan.cases.keys) if key not in kept))
    return {key: kept[key] for key in plan.cases.keys if key in kept}


def status_of(plan: SweepPlan, ledger: Ledger, outcomes: Mapping[str, Outcome]) -> Status:
    """Return the status of a sweep with the outcomes of its finished cases."""
    failed = {key for key, outcome in outcomes.items() if not outcome.converged}  # only their titles are shown
    cases = [
        BatchCase(key, plan.cases[place].title if key in failed else "", group)
        for place, (key, group) in enumerate(zip(plan.cases.keys, plan.cases.reuse_groups, strict=True))
    ]
    return status(plan.sweep.sweep, cases, ledger, outcomes, retry=RETRY)


def series_line(outcomes: Mapping[str, Outcome]) -> list[str]:
    """Return the line on cases that began with values of power series; empty without any."""
    starts = [outcome.start for outcome in outcomes.values() if outcome.by_series]
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
