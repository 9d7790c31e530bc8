"""The ledger of a store, by one process: what it keeps and does not believe, whom it takes for dead, what it says."""

from __future__ import annotations

import gzip
import json
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.ledger_files import (
    DONE,
    FAILED,
    KEY,
    OTHER,
    earlier_file,
    entries,
    finished,
    lines,
    shard_of,
)

from hpcinv.base.files import atomic
from hpcinv.base.parallel import processes
from hpcinv.base.parallel.processes import Identity
from hpcinv.errors import OutputError
from hpcinv.studies.batch.ledger import liveness
from hpcinv.studies.batch.ledger.case_record import CaseRecord, sealed
from hpcinv.studies.batch.ledger.claims import CaseState
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger, ledger_of

# What it keeps


def test_a_record_is_read_as_it_was_written(ledger: Ledger) -> None:
    """Also its brief, which another reader of JSON parses."""
    numbers = [0.1, 1 / 3, 5e-324, 1.7976931348623157e308, -0.0, 2**63, "µ → ∞", None, True, {"a": [[], {}]}]
    drawn = np.random.default_rng(1).integers(0, 2**62, 1000).view(float).tolist()  # of all magnitudes
    record = CaseRecord("converged", "", {"quantities": {"a": numbers, "b": drawn}}, 1e-3, 3, KEY)
    claim = ledger.claim(KEY)
    assert claim is not None
    assert ledger.commit(claim, record)
    for again in (CaseRecord.decoded(record.encoded()), dict(ledger.briefs([KEY]))[KEY]):
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
    assert len(lines(store)) == 1
    assert len(entries(store)) == 1


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

        monkeypatch.setattr("hpcinv.studies.batch.ledger.log.create", late)
        claim = ledger.claim(KEY)
        expected = {begun: "running", begun_again: "running", finished: "finished"}.get(history)
        assert (claim is None) == (expected is not None)
        if expected is None:  # open again, so that the second attempt to claim it succeeds
            assert claim is not None
            assert ledger.commit(claim, DONE)
        else:
            assert ledger.states([KEY])[KEY].name == expected


# What it does not believe


WHOLE = DONE.encoded()


@pytest.mark.parametrize(
    "damaged",
    [
        lambda line: line.replace(b"0.1", b"0.2"),
        lambda line: line.replace(b"0.1", b"\xff.1"),
        lambda line: line[:100] + bytes(len(line) - 101) + b"\n",
        lambda line: line[:-40] + b"\n",
    ],
)
@pytest.mark.parametrize("at_once", [True, False])
def test_a_damaged_line_is_not_believed_and_its_case_is_open(
    at_once: bool, ledger: Ledger, store: Path, damaged: Callable[[bytes], bytes]
) -> None:
    claim = ledger.claim(KEY)
    assert claim is not None
    ledger.commit(claim, DONE)
    [line] = lines(store)
    shard_of(store).write_bytes(damaged(line))
    with Holder(store) as other:
        reader = Ledger(store, other)
        assert reader.record(KEY) is None
        assert dict(reader.records([KEY, OTHER])) == {}
        assert reader.damaged([KEY, OTHER]) == [KEY]
        assert len(entries(store)) == 1  # reading writes nothing
        if at_once:
            assert reader.reopen_damaged([KEY, OTHER]) == 1
            assert reader.states([KEY])[KEY] == CaseState("open")
            assert reader.damaged([KEY]) == []
            assert reader.reopen_damaged([KEY]) == 0
        again = reader.claim(KEY)
        assert again is not None
        assert again.round == 2
        assert reader.commit(again, FAILED)
        assert reader.record(KEY) == FAILED


def test_a_whole_record_that_is_damaged_opens_its_case(ledger: Ledger, store: Path) -> None:
    """The numbers of the table are in another file, and stay."""
    claim = ledger.claim(KEY)
    assert claim is not None
    ledger.commit(claim, DONE)
    [whole] = (store / "ledger" / "records").glob("*.gz")
    assert gzip.decompress(whole.read_bytes()) == DONE.encoded()
    whole.write_bytes(whole.read_bytes()[:-9])
    assert ledger.record(KEY) is None
    assert dict(ledger.briefs([KEY])) == {KEY: DONE}
    assert ledger.damaged([KEY]) == [KEY]
    again = ledger.claim(KEY)
    assert again is not None
    assert again.round == 2


@pytest.mark.parametrize("tail", [b'{"case": {"key": "', WHOLE[:20], bytes(300)])
def test_an_incomplete_last_line_is_left_out_and_overwritten(ledger: Ledger, store: Path, tail: bytes) -> None:
    for key in (KEY, OTHER):
        claim = ledger.claim(key)
        assert claim is not None
        if key == OTHER:
            with shard_of(store).open("ab") as file:
                file.write(tail)  # as of a write that failed
            assert dict(ledger_of(store).records([KEY, OTHER])) == {KEY: DONE}
        ledger.commit(claim, DONE)
    assert dict(ledger_of(store).records([KEY, OTHER])) == {KEY: DONE, OTHER: DONE}


def test_further_entries_of_a_newer_version_are_ignored(ledger: Ledger, store: Path) -> None:
    claim = ledger.claim(KEY)
    assert claim is not None
    ledger.commit(claim, DONE)
    content = json.loads(lines(store)[0])["case"]
    newer = sealed("case", content | {"of a newer version": [1]})
    shard_of(store).write_bytes(newer)
    with Holder(store) as other:
        reader = Ledger(store, other)
        assert reader.record(KEY) == DONE
        assert dict(reader.records([KEY, OTHER])) == {KEY: DONE}
        assert reader.damaged([KEY]) == []
        assert reader.reopen_damaged([KEY]) == 0
        assert reader.claim(KEY) is None
    assert shard_of(store).read_bytes() == newer


@pytest.mark.parametrize("is_earlier", [False, True])
def test_a_whole_record_that_cannot_be_read_is_of_another_version_and_is_kept(is_earlier: bool, store: Path) -> None:
    """Its digest shows that it is as it was written: nothing is solved again."""
    what = "it has no 'advice', 'statistics', 'seconds', 'attempts'"
    with Holder(store) as me:
        if is_earlier:
            file = earlier_file(store)
            file.write_bytes(sealed("record", {"status": "converged"}))
        else:
            ledger = Ledger(store, me)
            claim = ledger.claim(KEY)
            assert claim is not None
            ledger.commit(claim, DONE)
            file = shard_of(store)
            data = json.loads(lines(store)[0])["case"]
            file.write_bytes(sealed("case", data | {"brief": {"status": "converged"}}))
            [whole] = file.parent.glob("*.gz")
            content = gzip.compress(sealed("record", {"status": "converged"}), mtime=0)
            whole.write_bytes(content)
            data |= {"brief": {"status": "converged"}, "at": [0, len(content)]}
            file.write_bytes(sealed("case", data))
        before = {path: path.read_bytes() for path in (store / "ledger").rglob("*") if path.is_file()}
        reader = Ledger(store, me)
        uses: list[Callable[[], object]] = [
            lambda: reader.record(KEY),
            lambda: dict(reader.records([KEY])),
            lambda: dict(reader.briefs([KEY])),
            lambda: reader.damaged([KEY]),
            lambda: reader.reopen_damaged([KEY]),
            lambda: reader.claim(KEY),
            lambda: reader.retry(KEY),
        ]
        for use in uses:
            with pytest.raises(OutputError) as refused:
                use()
            assert str(file.parent) in refused.value.message
            assert f"another version of hpcinv wrote it: {what}" in refused.value.message
            assert "choose another 'store'" in refused.value.advice
    assert {path: path.read_bytes() for path in (store / "ledger").rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("damaged", [b"", b'{"entry": {"claims": [["', b"[1]"])
def test_an_incomplete_last_entry_lasts_as_long_as_the_lease(
    store: Path, clock: Callable[[float], None], damaged: bytes
) -> None:
    """As a process leaves it that is killed on a file system without hard links."""
    with Holder(store) as me:
        ledger = Ledger(store, me)
        (store / "ledger" / "log" / "00000001.json").write_bytes(damaged)
        assert ledger.claim(KEY) is None
        assert ledger.states([KEY])[KEY] == CaseState("open")
        clock(liveness.LEASE - 0.1)
        assert ledger.claim(KEY) is None
        clock(0.1)
        claim = ledger.claim(KEY)
        assert claim is not None
        assert ledger.commit(claim, DONE)
    assert ledger_of(store).record(KEY) == DONE  # at once: whoever wrote the next entry has waited


def test_partial_files_are_ignored(ledger: Ledger, store: Path) -> None:
    (store / "ledger" / "log" / ".00000001.json.0a1b.partial").write_bytes(WHOLE[:20])
    (store / "ledger" / "records" / ".nfs0000012").touch()
    claim = ledger.claim(KEY)
    assert claim is not None
    assert ledger.commit(claim, DONE)
    assert ledger.record(KEY) == DONE


# Whom it takes for dead


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Lets time pass on our own monotonic clock."""
    now = 1000.0

    def advance(seconds: float) -> None:
        nonlocal now
        now += seconds

    monkeypatch.setattr(liveness, "monotonic", lambda: now)
    monkeypatch.setattr("hpcinv.studies.batch.ledger.log.monotonic", lambda: now)
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
