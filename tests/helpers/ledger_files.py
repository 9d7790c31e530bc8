"""Files of a ledger that tests write and read."""

from __future__ import annotations

from pathlib import Path

from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.ledger import CaseState, Ledger

KEY, OTHER = "ab" + 18 * "0", "ab" + 18 * "1"
DONE = CaseRecord("converged", "", {"quantities": {"length": 0.1}}, 1.5, 1)
FAILED = CaseRecord("a limit points of the path", "more steps", {}, 0.1, 1, OTHER)


def record_file(store: Path, number: int = 1) -> Path:
    return store / "ledger" / "ab" / f"{KEY}.record-{number}.json"


def files(store: Path) -> set[str]:
    return {path.name.removeprefix(f"{KEY}.") for path in (store / "ledger").glob("*/*")}


def test_only_a_failed_case_is_tried_again(ledger: Ledger, store: Path) -> None:
    assert not ledger.retry(KEY)
    first = ledger.claim(KEY)
    assert first is not None
    assert not ledger.retry(KEY)
    first.run.mkdir(parents=True)
    ledger.commit(first, FAILED)
    assert ledger.retry(KEY)
    assert not ledger.retry(KEY)
    assert ledger.states([KEY])[KEY] == CaseState("open")
    assert ledger.record(KEY) is None
    second = ledger.claim(KEY)
    assert second is not None
    assert (second.round, second.attempt, second.died) == (2, 1, 0)
    assert not any(ledger.directory(KEY).iterdir())
    assert not ledger.commit(first, DONE)  # too late: that round is over
    assert ledger.commit(second, DONE)
    assert not ledger.retry(KEY)
    assert ledger.record(KEY) == DONE
    assert CaseRecord.decoded(record_file(store).read_bytes()) == FAILED  # it is kept


def finished(ledger: Ledger, meanwhile: Ledger) -> None:
    claim = meanwhile.claim(KEY)
    assert claim is not None
    assert meanwhile.commit(claim, FAILED)
