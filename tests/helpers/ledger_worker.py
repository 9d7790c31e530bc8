"""A process that works on cases of a store until all are finished, for tests; it may die before any file operation.

What it does goes to a log of its own, a line for each event: time on the clock that all processes of this machine share
(in nanoseconds), event, key, claim.
"""

from __future__ import annotations

import argparse
import fcntl
import os
import random
import signal
import sys
import time
from pathlib import Path
from typing import Any

from hpcinv.base.parallel import processes
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.claims import Claim
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger

OPERATIONS = {"open", "os.link", "os.remove", "os.rename", "os.mkdir", "os.scandir"}


def die_before_operation(number: int, store: Path) -> None:
    """Let this process be killed before its n-th operation on files of the store; flushing counts too."""
    left = number

    def count() -> None:
        nonlocal left
        left -= 1
        if left == 0:
            os.kill(os.getpid(), signal.SIGKILL)

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event in OPERATIONS and str(store) in str(arguments[0]):
            count()

    flush = os.fsync

    def flush_or_die(descriptor: int) -> None:
        count()
        flush(descriptor)

    write = os.pwrite

    def write_or_die(descriptor: int, content: Any, offset: int) -> int:
        nonlocal left
        if left == 2:
            write(descriptor, content[: len(content) // 2], offset)  # it is killed while it writes
        count()
        return write(descriptor, content, offset)

    os.fsync, os.pwrite = flush_or_die, write_or_die
    sys.addaudithook(hook)


class Worker:
    def __init__(self, store: Path, log: Path, work: float, lease: float) -> None:
        self.store, self.work = store, work
        self.log_file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self.holder = Holder(store, beat=0.1)
        self.ledger = Ledger(store, self.holder, lease=lease)

    def log(self, event: str, key: str = "-", attempt: int = 0) -> None:
        os.write(self.log_file, f"{time.monotonic_ns()} {event} {key} {attempt}\n".encode())

    def finish(self, keys: list[str]) -> None:
        while keys := [key for key, state in self.ledger.states(keys).items() if state.name != "finished"]:
            random.shuffle(keys)
            left = [*keys]
            while left:
                size = min(random.choice((1, 2, 5)), len(left))
                block, left = left[:size], left[size:]
                for claim in self.ledger.claim_all(block):
                    self.solve(claim)

    def solve(self, claim: Claim) -> None:
        self.log("begin", claim.key, claim.attempt)
        with (self.store.parent / f"{claim.key}.lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # the system's own answer to whether we are alone
            except BlockingIOError:
                self.log("overlap", claim.key, claim.attempt)
            claim.run.mkdir(parents=True, exist_ok=True)
            steps = claim.run / "steps"
            with steps.open("a") as file:
                file.write(f"{claim.attempt}\n")
            time.sleep(random.uniform(0, 2 * self.work))
            statistics = {"solved": time.monotonic_ns(), "steps": steps.read_text().split()}
        if self.ledger.commit(claim, CaseRecord("converged", "", statistics, 0.1, claim.attempt)):
            self.log("committed", claim.key, claim.attempt)
        else:
            self.log("refused", claim.key, claim.attempt)

    def hold(self, key: str) -> None:
        """Claim a case, be stopped with all that belongs to us, and commit when we wake up."""
        claim = self.ledger.claim(key)
        assert claim is not None
        claim.run.mkdir(parents=True)
        (claim.run / "steps").write_text("1\n")
        heartbeat = self.holder._process
        assert heartbeat is not None
        self.log(f"heartbeat-{heartbeat.pid}", key)
        os.kill(heartbeat.pid, signal.SIGSTOP)
        os.kill(os.getpid(), signal.SIGSTOP)
        self.log("saved" if claim.run.exists() else "homeless", key)
        mine = CaseRecord("converged", "", {"by": "the one who was stopped"}, 0.1, 1)
        self.log("committed" if self.ledger.commit(claim, mine) else "refused", key)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("store", type=Path)
    parser.add_argument("log", type=Path)
    parser.add_argument("keys", nargs="+")
    parser.add_argument("--work", type=float, default=0.0)
    parser.add_argument("--lease", type=float, default=60.0)
    parser.add_argument("--die", type=int, default=0)
    parser.add_argument("--elsewhere", action="store_true")
    parser.add_argument("--hold", action="store_true")
    parser.add_argument("--no-links", action="store_true")
    arguments = parser.parse_args()
    if arguments.elsewhere:
        processes._this_machine = lambda host: f"not this one {os.getpid()}"
    if arguments.no_links:

        def no_links(*_: object) -> None:
            raise PermissionError(1, "Operation not permitted")

        os.link = no_links
    worker = Worker(arguments.store, arguments.log, arguments.work, arguments.lease)
    with worker.holder:
        if arguments.die:
            die_before_operation(arguments.die, arguments.store)
        worker.log("ready")
        if arguments.hold:
            worker.hold(arguments.keys[0])
        else:
            worker.finish(arguments.keys)
    worker.log("done")


if __name__ == "__main__":
    main()
