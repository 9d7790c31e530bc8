"""The ledger of a store, by one process: what it keeps and does not believe, whom it takes for dead, what it says."""

from __future__ import annotations

import json
import os
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers.ledger_files import (
    DONE,
    FAILED,
    KEY,
    OTHER,
    files,
    finished,
    record_file,
)

from hpcinv.base.files import atomic
from hpcinv.base.parallel import processes
from hpcinv.base.parallel.processes import Identity
from hpcinv.errors import OutputError
from hpcinv.studies.batch.ledger import liveness
from hpcinv.studies.batch.ledger.case_record import CaseRecord, _sealed
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import CaseState, Ledger

# What it keeps


def test_a_record_is_read_as_it_was_written() -> None:
    numbers = [0.1, 1 / 3, 5e-324, 1.7976931348623157e308, -0.0, 2**63, "µ → ∞", None, True, {"a": [[], {}]}]
    record = CaseRecord("converged", "", {"numbers": numbers}, 1e-3, 3, KEY)
    again = CaseRecord.decoded(record.encoded())
    assert again == record
    assert str(again) == str(record)  # distinguishes 1 from 1.0 and 0.0 from -0.0


def test_non_finite_values_are_null_in_a_record() -> None:
    record = CaseRecord("diverged", "", {"a": [float("nan"), (float("inf"), 1.0)]}, 1.0, 1)
    assert CaseRecord.decoded(record.encoded()).statistics == {"a": [None, [None, 1.0]]}


def test_a_case_is_claimed_once_and_finished_once(ledger: Ledger, store: Path) -> None:
    assert ledger.states([KEY, OTHER]) == {KEY: CaseState("open"), OTHER: CaseState("open")}
    claim = ledger.claim(KEY)
    assert claim is not None
    assert (claim.attempt, claim.died) == (1, 0)
    assert ledger.claim(KEY) is None
    state = ledger.states([KEY])[KEY]
    assert state.name == "running"
    assert f"process {os.getpid()} on" in state.holder
    assert ledger.commit(claim, DONE)
    assert not ledger.commit(claim, FAILED)
    assert ledger.record(KEY) == DONE
    assert ledger.claim(KEY) is None
    assert ledger.states([KEY, OTHER]) == {KEY: CaseState("finished"), OTHER: CaseState("open")}
    assert dict(ledger.records([OTHER, KEY])) == {KEY: DONE}
    assert files(store) == {"record-1.json"}


def test_a_case_given_back_goes_on_with_what_was_saved(ledger: Ledger) -> None:
    first = ledger.claim(KEY)
    assert first is not None
    first.run.mkdir(parents=True)
    (first.run / "checkpoint").write_text("half way")
    ledger.release(first)
    assert ledger.states([KEY])[KEY] == CaseState("open")
    second = ledger.claim(KEY)
    assert second is not None
    assert (second.attempt, second.died) == (2, 0)
    assert (second.run / "checkpoint").read_text() == "half way"
    assert not first.run.exists()
    assert not ledger.commit(first, DONE)  # its claim is over
    assert ledger.commit(second, DONE)


def begun(ledger: Ledger, meanwhile: Ledger) -> None:
    assert meanwhile.claim(KEY) is not None


def given_back(ledger: Ledger, meanwhile: Ledger) -> None:
    claim = meanwhile.claim(KEY)
    assert claim is not None
    meanwhile.release(claim)


def to_be_tried_again(ledger: Ledger, meanwhile: Ledger) -> None:
    finished(ledger, meanwhile)
    assert meanwhile.retry(KEY)


def begun_again(ledger: Ledger, meanwhile: Ledger) -> None:
    to_be_tried_again(ledger, meanwhile)
    assert meanwhile.claim(KEY) is not None


@pytest.mark.parametrize("history", [begun, given_back, finished, to_be_tried_again, begun_again])
@pytest.mark.parametrize("before", [0, 1])
def test_late_claims_of_a_taken_case_fail(
    ledger: Ledger,
    store: Path,
    monkeypatch: pytest.MonkeyPatch,
    before: int,
    history: Callable[[Ledger, Ledger], None],
) -> None:
    with Holder(store) as other:
        faster = Ledger(store, other)
        for _ in range(before):
            given_back(ledger, faster)
        create = atomic.create

        def late(path: Path, content: bytes) -> bool:
            monkeypatch.undo()
            history(ledger, faster)
            return create(path, content)

        monkeypatch.setattr("hpcinv.studies.batch.ledger.ledger.create", late)
        assert ledger.claim(KEY) is None
        state = ledger.states([KEY])[KEY]  # as if nothing had happened
        assert state.name == {begun: "running", begun_again: "running", finished: "finished"}.get(history, "open")
        assert (ledger.claim(KEY) is None) == (state.name != "open")


# What it does not believe


WHOLE = DONE.encoded()
WRONG_TYPE = b"whole, but with a word for a number"


@pytest.mark.parametrize(
    "damaged",
    [
        b"",
        WHOLE[:-1],
        WHOLE[: len(WHOLE) // 2],
        WHOLE.replace(b"0.1", b"0.2"),
        WHOLE.replace(b"0.1", b"\xff.1"),
        WHOLE + b"\n",
        bytes(len(WHOLE)),
        b'{"record": {}}',
        b"[]",
    ],
)
@pytest.mark.parametrize("at_once", [True, False])
def test_a_damaged_record_is_not_believed_and_its_case_is_open(
    at_once: bool, ledger: Ledger, store: Path, damaged: bytes
) -> None:
    claim = ledger.claim(KEY)
    assert claim is not None
    ledger.commit(claim, DONE)
    record_file(store).write_bytes(damaged)
    assert ledger.record(KEY) is None
    assert dict(ledger.records([KEY, OTHER])) == {}
    assert ledger.damaged([KEY, OTHER]) == [KEY]
    assert files(store) == {"record-1.json"}  # reading writes nothing
    if at_once:
        assert ledger.reopen_damaged([KEY, OTHER]) == 1
        assert ledger.states([KEY])[KEY] == CaseState("open")
        assert ledger.damaged([KEY]) == []
        assert ledger.reopen_damaged([KEY]) == 0
    assert record_file(store).read_bytes() == damaged  # left for who wants to know
    again = ledger.claim(KEY)
    assert again is not None
    assert ledger.commit(again, FAILED)
    assert ledger.record(KEY) == FAILED


def test_further_entries_of_a_newer_version_are_ignored(ledger: Ledger, store: Path) -> None:
    claim = ledger.claim(KEY)
    assert claim is not None
    ledger.commit(claim, DONE)
    content = json.loads(record_file(store).read_bytes())["record"]
    newer = _sealed(json.dumps({"of a newer version": [1]} | content).encode())
    record_file(store).write_bytes(newer)
    assert ledger.record(KEY) == DONE
    assert dict(ledger.records([KEY, OTHER])) == {KEY: DONE}
    assert ledger.damaged([KEY]) == []
    assert ledger.reopen_damaged([KEY]) == 0
    assert ledger.claim(KEY) is None
    assert record_file(store).read_bytes() == newer


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (b'{"status": "converged"}', "it has no 'advice', 'statistics', 'seconds', 'attempts'"),
        (b"[]", "it is not a mapping"),
        (b"{", "it is not JSON"),
    ],
)
def test_a_whole_record_that_cannot_be_read_is_of_another_version_and_is_kept(
    ledger: Ledger, store: Path, content: bytes, what: str
) -> None:
    """Its digest shows that it is as it was written: nothing is solved again."""
    claim = ledger.claim(KEY)
    assert claim is not None
    ledger.commit(claim, DONE)
    record_file(store).write_bytes(_sealed(content))
    uses: list[Callable[[], object]] = [
        lambda: ledger.record(KEY),
        lambda: dict(ledger.records([KEY])),
        lambda: ledger.damaged([KEY]),
        lambda: ledger.reopen_damaged([KEY]),
        lambda: ledger.claim(KEY),
        lambda: ledger.retry(KEY),
    ]
    for use in uses:
        with pytest.raises(OutputError) as refused:
            use()
        assert str(record_file(store)) in refused.value.message
        assert f"another version of hpcinv wrote it: {what}" in refused.value.message
        assert "choose another 'store'" in refused.value.advice
    assert files(store) == {"record-1.json"}
    assert record_file(store).read_bytes() == _sealed(content)


@pytest.mark.parametrize(
    "damaged", [b"", b'{"holder": {"token": "x"', b'{"holder": {"token": "x"}}', b"[1]", WRONG_TYPE]
)
def test_a_damaged_claim_lasts_as_long_as_the_lease(
    ledger: Ledger, store: Path, clock: Callable[[float], None], damaged: bytes
) -> None:
    ledger.claim(KEY)
    file = store / "ledger" / "ab" / f"{KEY}.claim-1-1.json"
    file.write_bytes(re.sub(rb'"pid": (\d+)', rb'"pid": "\1"', file.read_bytes()) if damaged is WRONG_TYPE else damaged)
    assert ledger.claim(KEY) is None
    assert ledger.states([KEY])[KEY] == CaseState("running", "unknown")
    clock(liveness.LEASE - 0.1)
    assert ledger.claim(KEY) is None
    clock(0.1)
    claim = ledger.claim(KEY)
    assert claim is not None
    assert claim.died == 1


def test_partial_files_are_ignored_and_removed_with_the_record(ledger: Ledger, store: Path) -> None:
    directory = store / "ledger" / "ab"
    directory.mkdir()
    for name in ("record-1.json", "claim-1-7.json", "reopened-4.json", "released-1-1"):
        (directory / f".{KEY}.{name}.0a1b.partial").write_bytes(WHOLE[:20])
    (directory / ".nfs0000012").touch()
    claim = ledger.claim(KEY)
    assert claim is not None
    assert (claim.round, claim.attempt) == (1, 1)
    ledger.commit(claim, DONE)
    assert files(store) == {"record-1.json", ".nfs0000012"}


# Whom it takes for dead


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Lets time pass on our own monotonic clock."""
    now = 1000.0

    def advance(seconds: float) -> None:
        nonlocal now
        now += seconds

    monkeypatch.setattr(liveness, "monotonic", lambda: now)
    return advance


@pytest.fixture
def elsewhere(store: Path) -> Iterator[Holder]:
    """A holder on another machine, whose heartbeat the test writes itself."""
    with Holder(store, beat=1e6) as other:
        other.identity = replace(other.identity, machine="another", pid=1)
        yield other


def test_a_process_elsewhere_is_dead_after_a_lease_without_heartbeat(
    ledger: Ledger, store: Path, elsewhere: Holder, clock: Callable[[float], None]
) -> None:
    assert Ledger(store, elsewhere).claim(KEY) is not None
    assert ledger.claim(KEY) is None  # seen for the first time
    assert not ledger.states([KEY])[KEY].living  # as far as is known yet
    for beat in range(2, 50):
        clock(liveness.LEASE - 0.1)
        elsewhere.heartbeat.write_bytes(b"%020d" % beat)
        assert ledger.claim(KEY) is None
        assert ledger.states([KEY])[KEY].living
    clock(liveness.LEASE - 0.1)
    assert ledger.claim(KEY) is None
    assert ledger.states([KEY])[KEY].name == "running"
    clock(0.1)
    assert ledger.states([KEY])[KEY] == CaseState("open", died=1)
    claim = ledger.claim(KEY)
    assert claim is not None
    assert (claim.attempt, claim.died) == (2, 1)
    assert not elsewhere.heartbeat.exists()  # nobody needs it any more


def test_a_process_elsewhere_that_never_had_a_heartbeat_is_dead_after_the_lease(
    ledger: Ledger, store: Path, elsewhere: Holder, clock: Callable[[float], None]
) -> None:
    assert Ledger(store, elsewhere).claim(KEY) is not None
    elsewhere.heartbeat.unlink()
    assert ledger.claim(KEY) is None
    clock(liveness.LEASE - 0.1)
    assert ledger.claim(KEY) is None
    clock(0.1)
    assert ledger.claim(KEY) is not None


@pytest.mark.parametrize("hours", [-1000, 1000])
def test_clocks_that_are_wrong_change_nothing(
    ledger: Ledger,
    store: Path,
    elsewhere: Holder,
    clock: Callable[[float], None],
    monkeypatch: pytest.MonkeyPatch,
    hours: int,
) -> None:
    right = time.time
    monkeypatch.setattr(time, "time", lambda: right() + 3600 * hours)
    assert Ledger(store, elsewhere).claim(KEY) is not None
    for path in store.rglob("*"):
        os.utime(path, (right() - 3600 * hours, right() - 3600 * hours))
    assert ledger.claim(KEY) is None
    clock(liveness.LEASE - 0.1)
    for path in store.rglob("*"):
        os.utime(path, (right() + 7200 * hours, right() + 7200 * hours))
    assert ledger.claim(KEY) is None
    clock(0.1)
    assert ledger.claim(KEY) is not None


def identity(**changes: Any) -> Identity:
    return replace(Identity.current(), **changes)


@pytest.mark.parametrize(
    ("other", "dead"),
    [
        (identity(), False),
        (identity(started="1"), True),  # the number was given to another process since
        (identity(pid=2**22 - 1), True),
        (identity(pid=2**22 - 1, machine="another"), False),  # not yet
        (identity(started="1", machine=""), False),
        (identity(machine="another", job="cluster/7", restart=0), True),
        (identity(machine="another", job="cluster/7", restart=1), False),
        (identity(machine="another", job="elsewhere/7", restart=0), False),
        (identity(machine="another", job="cluster/8", restart=0), False),
        (identity(job="cluster/7", restart=0), False),  # it is there, whatever Slurm counts
    ],
)
def test_processes_known_to_be_dead(store: Path, other: Identity, dead: bool) -> None:
    me = identity(job="cluster/7", restart=1)
    assert liveness.Watch(store, me, 60.0).is_dead(other) is dead
    outside = identity(job="")
    assert liveness.Watch(store, outside, 60.0).is_dead(replace(other, job="", machine="another")) is False


def test_a_zombie_is_dead() -> None:
    with subprocess.Popen(["sleep", "100"]) as process:
        assert processes.start_of(process.pid)
        process.kill()
        while Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z":
            time.sleep(0.001)
        assert processes.start_of(process.pid) == ""


def test_slurm_names_the_job() -> None:
    slurm = {"SLURM_CLUSTER_NAME": "c", "SLURM_JOB_ID": "7", "SLURM_RESTART_COUNT": "2"}
    me = Identity.current(slurm)
    assert (me.job, me.restart) == ("c/7", 2)
    assert str(me).endswith("(job 7)")
    alone = Identity.current({})
    assert (alone.job, alone.restart) == ("", 0)
    assert me.token != alone.token
    assert Identity.from_json(me.as_json()) == me
