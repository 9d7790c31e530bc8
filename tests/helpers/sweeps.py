"""What the tests of sweeps share: a small sweep as a file, and its records."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from helpers.command_line import BLOCK
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.ledger import Ledger, ledger_of
from hpcinv.studies.sweep.sweep_plan import SweepPlan, load_sweep


def write_sweep(directory: Path, axes: list[dict[str, Any]], *, job: Mapping[str, Any] = BLOCK, **more: Any) -> Path:
    """A sweep file in the directory of its job and its store."""
    (directory / "block.yaml").write_text(yaml.safe_dump(dict(job), sort_keys=False))
    path = directory / "sweep.yaml"
    path.write_text(yaml.safe_dump({"job": "block.yaml", "store": "store", "axes": axes, **more}, sort_keys=False))
    return path


def finish(ledger: Ledger, key: str, record: CaseRecord) -> None:
    """Put a record into a store, as a process does that has solved a case."""
    claim = ledger.claim(key)
    assert claim is not None
    assert ledger.commit(claim, record)


def records_of(sweep: Path) -> dict[int, CaseRecord | None]:
    """Records by the number of the case."""
    plan: SweepPlan = load_sweep(sweep)
    ledger = ledger_of(plan.store)
    return {case.number: ledger.record(case.key) for case in plan.cases}
