"""The ledger's protocol, step by step: several processes whose file operations take turns in an order that is drawn.

Each is a thread that stops before every file operation; then one of all is chosen to go on, or to be killed. Who lives
is known here, not watched, so that whatever goes wrong is the protocol's fault.
"""

from __future__ import annotations

import os
import random
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hpcinv.base.parallel.processes import Identity
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.claims import Claim
from hpcinv.studies.batch.ledger.ledger import Ledger
from hpcinv.studies.batch.ledger.liveness import Watch
from hpcinv.studies.batch.ledger.shards import Shards
from hpcinv.studies.batch.ledger.store import open_store

KEY = "ab" + 18 * "0"
OPERATIONS = {"open", "os.link", "os.remove", "os.rename", "os.mkdir", "os.scandir", "os.pwrite"}


def ledger_of(store: Path) -> Ledger:
    holder: Any = SimpleNamespace(identity=Identity.current({}), is_beating=True)
    return Ledger(store, holder)


class Killed(BaseException):
    """Raised in a process at every operation that it would do after its death."""


class Process:
    """One of the processes; goes on by one operation with each `step`."""

    current = threading.local()

    def __init__(self, schedule: Schedule, act: Callable[[Process], None]) -> None:
        self.schedule, self.ledger = schedule, ledger_of(schedule.store)
        self.token = self.ledger.holder.identity.token
        self.killed = self.ended = False
        self.error: BaseException | None = None
        self._go, self._stopped = threading.Semaphore(0), threading.Semaphore(0)
        self._thread = threading.Thread(target=self._run, args=(act,))
        self._thread.start()

    def _run(self, act: Callable[[Process], None]) -> None:
        Process.current.process = self
        self._go.acquire()
        try:
            act(self)
        except Killed:
            pass
        except BaseException as error:
            self.error = error
        self.ended = True
        self._stopped.release()

    def step(self) -> None:
        self._go.release()
        self._stopped.acquire()
        if self.ended:
            self._thread.join()
        if self.error is not None:
            raise self.error

    def pause(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.killed:
            self._stopped.release()
            self._go.acquire()
        if self.killed:
            raise Killed
        if event == "os.pwrite":
            self.schedule.at_work.pop(self, None)  # from here on the others may know that it is finished


def _before_operation(event: str, arguments: tuple[Any, ...]) -> None:
    if event in OPERATIONS and (process := getattr(Process.current, "process", None)) is not None:
        process.pause(event, arguments)


@pytest.fixture(scope="module", autouse=True)
def _operations() -> None:
    sys.addaudithook(_before_operation)  # stays; it concerns only the threads above
    write = os.pwrite

    def pwrite(descriptor: int, content: Any, offset: int) -> int:
        _before_operation("os.pwrite", ())
        return write(descriptor, content, offset)

    os.pwrite = pwrite


class Schedule:
    """One order in which the processes take turns, and what must be so in every order."""

    def __init__(self, store: Path, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
        self.store, self.random = store, random.Random(seed)
        self.at_work: dict[Process, Claim] = {}
        self.commits: list[tuple[int, int]] = []  # rounds and claims
        self.dead: set[str] = set()
        self.suspicions = 0.0
        open_store(store)
        monkeypatch.setattr(Watch, "is_dead", lambda _, other: other.token in self.dead)
        monkeypatch.setattr(os, "fsync", lambda _: None)
        monkeypatch.setattr(time, "sleep", lambda _: None)

    def work(self, process: Process) -> None:
        for _ in range(15):
            if (claim := process.ledger.claim(KEY)) is None:
                continue
            if not self.suspicions:
                assert not self.at_work, "two work on one case"
                assert claim.round not in self.finished(), "it was finished"
            self.at_work[process] = claim
            claim.run.mkdir(parents=True, exist_ok=True)
            if (status := self.random.choice(["converged", "failed", "failed", "released"])) == "released":
                del self.at_work[process]
                process.ledger.release(claim)
            elif process.ledger.commit(claim, CaseRecord(status, "", {}, 0.1, claim.attempt)):
                self.commits.append((claim.round, claim.attempt))

    def retry(self, process: Process) -> None:
        for _ in range(30):
            process.ledger.retry(KEY)

    def finished(self) -> dict[int, int]:
        """The rounds with a record, each of which is whole, and the claim whose record counts."""
        shards = Shards(self.store / "ledger" / "records")
        places = [line.place for token in shards.tokens() for line in shards.new_lines(token)]
        for place in places:
            shards.whole(place)
        return {place.round: place.claim for place in sorted(places)}

    def run(self, deaths: float) -> None:
        """Play it to its end."""
        processes = [Process(self, self.work) for _ in range(3)] + [Process(self, self.retry) for _ in range(2)]
        chosen = processes[0]
        try:
            while left := [process for process in processes if not process.ended]:
                if chosen.ended or self.random.random() < 0.15:  # bursts: what has been seen is long over for others
                    chosen = self.random.choice(left)
                if self.random.random() < deaths:
                    self.kill(chosen)
                if self.random.random() < self.suspicions:
                    self.dead.add(self.random.choice(processes).token)
                chosen.step()
        finally:
            for process in processes:
                if not process.ended:
                    self.kill(process)
                    process.step()

    def kill(self, process: Process) -> None:
        process.killed = True
        self.dead.add(process.token)
        self.at_work.pop(process, None)


@pytest.mark.everyday("0.01")
@pytest.mark.parametrize("deaths", [0.0, 0.01])
def test_the_order_of_processes_does_not_matter(tmp_path: Path, deaths: float, monkeypatch: pytest.MonkeyPatch) -> None:
    rounds = 0
    for seed in range(60):
        schedule = Schedule(tmp_path / str(seed), seed, monkeypatch)
        schedule.run(deaths)
        finished = schedule.finished()
        committed = [number for number, _ in schedule.commits]
        assert [*finished] == list(range(1, len(finished) + 1))
        if deaths:  # also between the record's appearance and its process' knowledge of that
            assert set(committed) <= finished.keys()
        else:
            assert sorted(committed) == [*finished]
        assert len(set(committed)) == len(committed)
        rounds += len(finished)
        # Whoever comes later finds a case that is finished, or takes it.
        monkeypatch.setattr(Watch, "is_dead", lambda *_: True)
        later = ledger_of(schedule.store)
        assert later.states([KEY])[KEY].name in ("open", "finished")
        assert (later.claim(KEY) is None) == (later.record(KEY) is not None)
    assert rounds > 60  # else the orders were not varied enough


def test_of_processes_that_are_wrongly_taken_for_dead_one_commits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A commit returns true to one process at most, and the record of that process counts."""
    superseded = 0
    for seed in range(40):
        schedule = Schedule(tmp_path / str(seed), seed, monkeypatch)
        schedule.suspicions = 0.02
        schedule.run(0.0)
        finished = schedule.finished()
        assert len({number for number, _ in schedule.commits}) == len(schedule.commits)
        assert {(number, finished[number]) for number, _ in schedule.commits} == set(schedule.commits)
        superseded += sum(claim > 1 for claim in finished.values())
    assert superseded > 10
