"""Blocks of cases that a process claims together, and processes that were taken for dead and continue."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import pytest
from helpers.ledger_files import DONE, FAILED, KEY, entries

from hpcinv.base.files import atomic
from hpcinv.base.parallel.processes import Identity
from hpcinv.studies.batch.ledger import liveness
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger, ledger_of

# Blocks of cases


BLOCK = [f"ab{number:018x}" for number in range(4)]


def test_the_cases_of_a_block_are_claimed_together(ledger: Ledger, store: Path) -> None:
    taken = ledger.claim(BLOCK[1])
    assert taken is not None
    with Holder(store) as other:
        second = Ledger(store, other)
        claims = second.claim_all(BLOCK)
        assert [claim.key for claim in claims] == [BLOCK[0], BLOCK[2], BLOCK[3]]
        assert ledger.claim_all(BLOCK) == []
        states = ledger.states(BLOCK)
        assert [states[key].waits for key in BLOCK] == [False, False, True, True]
        assert second.commit(claims[0], DONE)
        states = ledger.states(BLOCK)
        assert [states[key].name for key in BLOCK] == ["finished", "running", "running", "running"]
        assert not states[BLOCK[2]].waits
        second.close()
        assert [state.died for state in ledger.states(BLOCK).values()] == [0, 0, 0, 0]
        assert [claim.key for claim in ledger.claim_all(BLOCK)] == BLOCK[2:]
    assert len(entries(store)) == 4


def test_only_the_case_at_hand_counts_as_an_attempt_of_a_process_that_died(
    ledger: Ledger, store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Holder(store) as other:
        second = Ledger(store, other)
        claims = second.claim_all(BLOCK)
        second.commit(claims[0], DONE)
        monkeypatch.setattr(liveness.Watch, "is_dead", lambda _, holder: holder.token == other.identity.token)
        assert [state.died for state in ledger.states(BLOCK).values()] == [0, 1, 0, 0]
        third = ledger.claim(BLOCK[3])
        assert third is not None
        assert (third.attempt, third.died) == (2, 0)
        assert [state.died for state in ledger.states(BLOCK).values()] == [0, 1, 0, 0]
        left = ledger.claim_all(BLOCK)
        assert [(claim.key, claim.died) for claim in left] == [(BLOCK[1], 1), (BLOCK[2], 0)]


def test_what_a_supervisor_notes_on_a_block(ledger: Ledger, store: Path) -> None:
    claims = ledger.claim_all(BLOCK)
    supervisor = ledger_of(store)
    assert supervisor.commit(claims[0], FAILED)
    assert ledger_of(store).record(BLOCK[0]) == FAILED
    assert [state.name for state in ledger.states(BLOCK).values()] == ["finished", "open", "open", "open"]
    assert not ledger.commit(claims[0], DONE)
    assert not ledger.commit(claims[1], DONE)
    claims = supervised(store).claim_all(BLOCK[2:])
    supervisor.crashed(claims[0], "ended by SIGSEGV")
    supervisor.release(claims[0])
    assert [state.name for state in ledger_of(store).states(BLOCK[2:]).values()] == ["open", "open"]


# What happens if a process that was taken for dead goes on


@pytest.mark.parametrize("first", ["the one", "the other"])
def test_a_process_and_its_successor_are_not_both_told_that_they_were_first(
    ledger: Ledger, store: Path, monkeypatch: pytest.MonkeyPatch, first: str
) -> None:
    with Holder(store) as other:
        successor = Ledger(store, other)
        claim = ledger.claim(KEY)
        assert claim is not None
        monkeypatch.setattr(liveness.Watch, "is_dead", lambda *_: True)
        if first == "the one":
            create = atomic.create

            def late(path: Path, content: bytes) -> bool:
                assert ledger.commit(claim, DONE)
                return create(path, content)

            monkeypatch.setattr("hpcinv.studies.batch.ledger.log.create", late)
            assert successor.claim(KEY) is None  # it has added its claim, and finds the record
        else:
            second = successor.claim(KEY)
            assert second is not None
            assert not ledger.commit(claim, FAILED)
            assert ledger_of(store).record(KEY) == FAILED  # counts until there is a better one
            assert successor.commit(second, DONE)
        assert ledger_of(store).record(KEY) == DONE


def supervised(store: Path) -> Ledger:
    return Ledger(store, Mock(identity=Identity.current({}), is_beating=True), supervised=True)
