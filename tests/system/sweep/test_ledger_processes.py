"""The ledger under many real processes that contend, are killed at any moment, or are stopped and wake up again."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from helpers.command_line import MPIRUN, PATIENCE, environment
from helpers.ledger_files import entries

from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.claims import CaseState
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger

WORKER = Path(__file__).parents[2] / "helpers" / "ledger_worker.py"
KEY = "ab" + 18 * "0"
BY_US = CaseRecord("converged", "", {"by": "us"}, 0.1, 1)


@dataclass(frozen=True)
class Event:
    """A line in the log of a worker."""

    time: int
    what: str
    key: str
    attempt: int


class Workers:
    """Processes that work on one store; none is left at the end."""

    def __init__(self, directory: Path) -> None:
        self.directory, self.store = directory, directory / "store"
        self.running: list[subprocess.Popen[bytes]] = []
        self.started = 0

    def start(self, *arguments: object) -> Path:
        """Start one more; gives its log."""
        log = self.directory / f"log-{self.started}"
        self.started += 1
        command = [sys.executable, str(WORKER), str(self.store), str(log), *map(str, arguments)]
        self.running.append(subprocess.Popen(command, env=environment()))
        return log

    def events(self) -> list[Event]:
        """Of all workers, in the order of time."""
        lines = [line.split() for log in self.directory.glob("log-*") for line in log.read_text().splitlines()]
        return sorted((Event(int(t), what, key, int(n)) for t, what, key, n in lines), key=lambda event: event.time)

    def wait(self) -> list[int]:
        return [process.wait(PATIENCE) for process in self.running]


@pytest.fixture
def workers(tmp_path: Path) -> Iterator[Workers]:
    all_workers = Workers(tmp_path)
    yield all_workers
    for process in all_workers.running:
        if process.poll() is None:
            process.kill()
            process.wait()


def keys_of(count: int) -> list[str]:
    return [f"{number % 4:02x}{number:018x}" for number in range(count)]


def check(workers: Workers, keys: list[str]) -> dict[str, CaseRecord]:
    """Each case has one whole record, none was begun after it or by two at a time."""
    events = workers.events()
    assert not [event for event in events if event.what == "overlap"]
    records = dict(Ledger(workers.store, Holder(workers.store)).records(keys))
    assert set(records) == set(keys)
    for event in events:
        if event.what == "begin":
            assert event.time < records[event.key].statistics["solved"]
    committed = Counter(event.key for event in events if event.what == "committed")
    assert set(committed.values()) <= {1}
    assert not any(entry.get("reopened") for entry in entries(workers.store))
    return records


@pytest.mark.parametrize("manners", [[], ["--no-links"]])
def test_processes_that_contend_do_each_case_once(workers: Workers, manners: list[str]) -> None:
    count, keys = (8, keys_of(200)) if not manners else (3, keys_of(60))
    for _ in range(count):
        workers.start(*keys, *manners)
    assert workers.wait() == [0] * count
    check(workers, keys)
    events = workers.events()
    assert Counter(event.key for event in events if event.what == "begin") == dict.fromkeys(keys, 1)
    assert Counter(event.key for event in events if event.what == "committed") == dict.fromkeys(keys, 1)
    assert sum(len(entry["claims"]) for entry in entries(workers.store)) == len(keys)
    assert not any((workers.store / "holders").iterdir())


@pytest.mark.release
def test_processes_killed_at_any_moment_lose_and_repeat_nothing(workers: Workers) -> None:
    """Each of the first before a drawn file operation, or earlier at a drawn time; the lease is far too long to matter.

    No process gets far enough that the cases could be finished without 18 kills, however fast the others are.
    """
    drawn, keys, killed = random.Random(5), keys_of(130), 0
    logs: dict[int, Path] = {}
    reader = Ledger(workers.store, Holder(workers.store))
    while any(state.name != "finished" for state in reader.states(keys).values()):
        while len(workers.running) < 3:
            dies = ["--die", drawn.randint(8, 45)] if killed < 24 else []
            log = workers.start(*keys, "--work", 0.01, *dies)
            logs[workers.running[-1].pid] = log
        time.sleep(drawn.uniform(0, 0.04))
        victim = drawn.choice(workers.running)
        if (
            killed < 24
            and drawn.random() < 0.3
            and logs[victim.pid].exists()
            and "begin" in logs[victim.pid].read_text()
        ):
            victim.kill()
        for process in [process for process in workers.running if process.poll() is not None]:
            workers.running.remove(process)
            assert process.returncode in (0, -signal.SIGKILL)
            killed += process.returncode != 0
    assert all(code in (0, -signal.SIGKILL) for code in workers.wait())
    print(killed, "killed")
    assert killed >= 18
    records = check(workers, keys)
    assert sum(record.attempts - 1 for record in records.values()) >= 6  # deaths while they had a case
    for record in records.values():  # what was saved before a kill was there afterwards
        steps = list(map(int, record.statistics["steps"]))
        assert steps == sorted(set(steps))
        assert steps[-1] == record.attempts


def test_a_process_killed_before_each_of_its_operations_in_turn(tmp_path: Path) -> None:
    """Whatever it has left, the case is finished and whole, or is taken over at once."""
    ends = Counter[str]()
    number = 0
    while True:
        number += 1
        workers = Workers(tmp_path / str(number))
        workers.directory.mkdir()
        workers.start(KEY, "--die", number)
        survived = workers.wait() == [0]
        with Holder(workers.store) as me:
            ledger = Ledger(workers.store, me)
            if ledger.record(KEY) is None:
                died = ledger.states([KEY])[KEY]
                claim = ledger.claim(KEY)
                assert died == CaseState("open", died=claim.died if claim else -1)
                assert claim is not None
                assert ledger.commit(claim, BY_US)
                assert ledger.record(KEY) == BY_US
                ends["before" if claim.died == 0 else "within"] += 1
            else:
                ends["after"] += 1
            assert ledger.claim(KEY) is None
            assert not ledger.retry(KEY)
        if survived:
            break
    assert ends["before"] >= 3
    assert ends["within"] >= 8
    assert ends["after"] >= 4


def wait_for(workers: Workers, what: str) -> Event:
    deadline = time.monotonic() + PATIENCE
    while not (events := [event for event in workers.events() if event.what.startswith(what)]):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return events[0]


def test_a_process_whose_case_was_taken_over_changes_nothing(workers: Workers) -> None:
    """The worker is on another machine and seen by its heartbeat only; both stop, as on a node that hangs."""
    log = workers.start(KEY, "--hold", "--elsewhere")
    stopped = workers.running[0].pid
    heartbeat = int(wait_for(workers, "heartbeat-").what.partition("-")[2])
    try:
        with Holder(workers.store) as me:
            ledger = Ledger(workers.store, me, lease=0.6)
            began = time.monotonic()
            assert ledger.claim(KEY) is None
            while (claim := ledger.claim(KEY)) is None:
                assert time.monotonic() < began + PATIENCE
                time.sleep(0.02)
            assert time.monotonic() >= began + 0.6
            assert (claim.attempt, claim.died) == (2, 1)
            assert (claim.run / "steps").read_text() == "1\n"
            assert ledger.commit(claim, BY_US)
            os.kill(heartbeat, signal.SIGCONT)
            os.kill(stopped, signal.SIGCONT)
            assert workers.wait() == [0]
            assert [line.split()[1] for line in log.read_text().splitlines()][2:] == ["homeless", "refused", "done"]
            assert ledger.record(KEY) == BY_US
    finally:
        for process in (heartbeat, stopped):
            try:
                os.kill(process, signal.SIGCONT)
            except ProcessLookupError:
                continue


BEATING = """
import os, signal, sys, time
from pathlib import Path
from hpcinv.studies.batch.ledger.holder import Holder

with Holder(Path(sys.argv[1]), beat=0.05) as me:
    print(me._process.pid, flush=True)
    for number in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}:
        os.kill(me._process.pid, number)
    before, deadline = me.heartbeat.read_bytes(), time.monotonic() + 20
    while me.heartbeat.read_bytes() == before:
        if time.monotonic() > deadline:
            sys.exit("no heartbeat")
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_heartbeat_outlives_signals_but_not_its_process(tmp_path: Path) -> None:
    """Nor does it keep open what others wait for: this would hang on its pipe."""
    command = [sys.executable, "-c", BEATING, str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, env=environment(), timeout=PATIENCE, check=False)
    assert ended.returncode == -signal.SIGKILL
    deadline = time.monotonic() + 20
    while Path(f"/proc/{int(ended.stdout)}").exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)
    assert not any((tmp_path / "holders").iterdir())


def test_mpirun_does_not_wait_for_heartbeats(tmp_path: Path) -> None:
    command = [MPIRUN, "-n", "2", sys.executable, "-c", BEATING, tmp_path]
    ended = subprocess.run(command, capture_output=True, env=environment(), timeout=PATIENCE / 2, check=False)
    assert ended.returncode != 0
    assert len(ended.stdout.split()) >= 2, ended.stderr
