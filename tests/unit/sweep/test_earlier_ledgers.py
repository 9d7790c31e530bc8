"""Stores of the first format, with one file for each record and claim: they are read and continued."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from helpers.ledger_files import DONE, FAILED, KEY, OTHER, earlier_file

from hpcinv.studies.batch.ledger.claims import CaseState
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger, ledger_of

WHOLE = DONE.encoded()


@pytest.mark.parametrize(
    "damaged", [b"", WHOLE[:-1], WHOLE.replace(b"0.1", b"0.2"), WHOLE + b"\n", bytes(len(WHOLE)), b'{"record": {}}']
)
@pytest.mark.parametrize("at_once", [True, False])
def test_a_damaged_file_of_an_earlier_ledger_is_not_believed(at_once: bool, store: Path, damaged: bytes) -> None:
    earlier_file(store).write_bytes(damaged)
    with Holder(store) as me:
        ledger = Ledger(store, me)
        assert ledger.record(KEY) is None
        assert ledger.damaged([KEY, OTHER]) == [KEY]
        if at_once:
            assert ledger.reopen_damaged([KEY, OTHER]) == 1
            assert ledger.states([KEY])[KEY] == CaseState("open")
        assert earlier_file(store).read_bytes() == damaged  # left for who wants to know
        again = ledger.claim(KEY)
        assert again is not None
        assert ledger.commit(again, DONE)
        assert ledger.record(KEY) == DONE


def test_cases_of_an_earlier_ledger_are_kept_and_continued(store: Path) -> None:
    earlier_file(store).write_bytes(FAILED.encoded())
    claimed = earlier_file(store, "claim-1-2.json").with_name(f"{OTHER}.claim-1-2.json")
    claimed.write_text("{}")
    assert dict(ledger_of(store).records([KEY, OTHER])) == {KEY: FAILED}
    assert json.loads((store / "store.json").read_text()) == {"format": "hpcinv store 1"}
    (store / "cases" / OTHER[:2] / OTHER / "run-1-2").mkdir(parents=True)
    with Holder(store) as me:
        ledger = Ledger(store, me)
        assert json.loads((store / "store.json").read_text()) == {"format": "hpcinv store 2"}
        assert ledger.claim(KEY) is None
        claim = ledger.claim(OTHER)
        assert claim is not None
        assert (claim.attempt, claim.died) == (3, 0)
        assert claim.run.is_dir()
        assert ledger.retry(KEY)
        again = ledger.claim(KEY)
        assert again is not None
        assert (again.round, again.attempt) == (2, 1)
        assert ledger.commit(again, DONE)
    assert dict(ledger_of(store).records([KEY, OTHER])) == {KEY: DONE}


def test_an_earlier_ledger_that_was_opened_again_is_in_its_latest_round(store: Path) -> None:
    earlier_file(store).write_bytes(FAILED.encoded())
    earlier_file(store, "reopened-2.json").write_text("{}")
    assert ledger_of(store).states([KEY]) == {KEY: CaseState("open")}
    earlier_file(store, "record-2.json").write_bytes(DONE.encoded())
    assert ledger_of(store).record(KEY) == DONE
