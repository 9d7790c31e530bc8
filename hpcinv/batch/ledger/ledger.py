"""The ledger of a store: which cases are finished, and who works on which, over any number of allocations at once.

The state of a case is the set of its files. Each is created once, whole and exclusively (`atomic`), and never
changed:

- ``KEY.claim-R-N.json``: claim N in round R, by whom; ``KEY.released-R-N``: it was given back.
- ``KEY.crashed-R-N.json``: its process crashed, and how, as the process saw that had started it.
- ``KEY.record-R.json``: how the case ended. A round has one at most.
- ``KEY.reopened-R.json``: round R has begun, since the record of the round before is damaged, or its case shall be
  tried again. Round 1 begins by itself.

A case is finished if its latest round has a record. Else it is open, and someone works on it if its last claim was
not released and has not lost its holder (`liveness`).

**Why nothing is done twice.** *While a round is open, its last claim is not removed*: claims go after the record is
there. To claim a case one looks, finds that claim N was released or has lost its holder, creates claim N + 1, which
only one can, and then looks again whether the round is still the latest, has no record, and no later claim. The first
look has seen all claims, unless they were just being removed; but then there was a record, which the second look sees.
So the claims of an open round are a chain: each is taken by one process, after the one before was over. Who was taken
for dead and wakes up finds, when he commits, that his claim is not the last, and when he saves, that his run directory
has another name. Should he commit in the same instant as his successor, one of them creates the record, and the other
is told.

**Why nothing is lost.** At whatever moment a process is killed, it leaves nothing, a partial file whose name nobody
else uses, a claim without a holder, or a whole record. None of these has to be repaired. What its run had saved is in
the run directory, which the next claim takes over by one rename.
"""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from hpcinv.batch.ledger.history import Histories, History
from hpcinv.batch.ledger.holder import Holder
from hpcinv.batch.ledger.liveness import LEASE, Watch
from hpcinv.batch.ledger.record import CaseRecord
from hpcinv.batch.ledger.store import open_store, runs_in, told
from hpcinv.errors import OutputError
from hpcinv.files.atomic import create, make_directory, publish
from hpcinv.parallel.processes import Identity

DEADLY = 5
"""So many processes must have died with a case until that is its own fault.

A process can also die with its allocation, through no fault of the case; so one or two deaths say nothing.
"""

LOST = 25
"""So many processes must have vanished together with their supervisor until that is the fault of the case.

A supervisor survives its case, so this is most likely a kill of the whole allocation: it counts for little.
"""

KILLED = "ended by SIGKILL"
"""How a process ended that was killed: perhaps because of a neighbour that took the memory."""

CRASHES = 2
"""So many crashes that a supervisor has seen, each in another process, are the fault of the case."""


@dataclass(frozen=True)
class Claim:
    """The right to work on a case.

    Attributes:
        round, attempt: which claim it is; both count from 1, attempts within the round.
        died: how many of the earlier attempts ended with their process.
        lost: how many further ones ended together with their supervisor.
        crashes: how earlier attempts ended that crashed their process.
        run: where checkpoints and results go, with what earlier attempts have saved; it need not exist.
    """

    key: str
    round: int
    attempt: int
    died: int
    run: Path
    crashes: tuple[str, ...] = ()
    lost: int = 0


@dataclass(frozen=True)
class State:
    """Where a case stands.

    Attributes:
        holder, since: who works on it, and since when by his clock; for people.
        died: how many attempts at an open case ended with their process.
        living: whether it is certain that the holder is alive.
    """

    name: Literal["open", "running", "finished"]
    holder: str = ""
    since: str = ""
    died: int = 0
    living: bool = False


class Ledger:
    """The cases of a store, as one process sees and changes them.

    Args:
        lease: seconds within which the heartbeat of a holder elsewhere must change.
        supervised: whether another process notes how this one ends.

    Raises:
        OutputError: from every method, where the file system fails; nothing half-written stays.
    """

    def __init__(self, path: Path, holder: Holder, *, lease: float = LEASE, supervised: bool = False) -> None:
        self.path, self.holder, self.lease, self.supervised = path, holder, lease, supervised
        self._files, self._watch = Histories(path), Watch(path, holder.identity, lease)

    def open(self) -> None:
        """Make the store, or check that it is one."""
        open_store(self.path)

    def directory(self, key: str) -> Path:
        """Where the runs of a case are; that of a claim is ``claim.run``."""
        return runs_in(self.path) / key[:2] / key

    def record(self, key: str) -> CaseRecord | None:
        """How a case ended; ``None`` if it is not finished. A record that is damaged opens its case again."""
        return self._read_record(key, self._files.of(key))

    def records(self, keys: Iterable[str]) -> Iterator[tuple[str, CaseRecord]]:
        """The same for those of many cases that are finished, each with its key; one scan of a directory for many."""
        for key, history in self._files.of_all(keys).items():
            if (record := self._read_record(key, history)) is not None:
                yield key, record

    def claim(self, key: str) -> Claim | None:
        """Take a case; ``None``, at once, if it is finished or its holder is, or may be, alive."""
        assert self.holder.is_beating
        before = self._files.of(key)
        if before.finished or self._is_held(key, before):
            return None
        attempt = before.claims + 1
        file = self._files.file(key, f"claim-{before.round}-{attempt}.json")
        content = {
            "holder": self.holder.identity.as_json(),
            "since": datetime.now(UTC).isoformat(timespec="seconds"),
            "supervised": self.supervised,
        }
        with told(file):
            make_directory(file.parent)
            if not create(file, json.dumps(content).encode()):
                return None
        run = self.directory(key) / f"run-{before.round}-{attempt}"
        lost = self._lost(key, before)
        claim = Claim(key, before.round, attempt, before.unreleased - lost, run, self._crashes(key, before), lost)
        if not _is_last(claim, self._files.of(key)):
            with told(file):
                file.unlink(missing_ok=True)
            return None
        if attempt > 1:
            self._take_over(claim, before)
        return claim

    def commit(self, claim: Claim, record: CaseRecord) -> bool:
        """Record how a claimed case ended; ``False`` if another process has taken it over, or was first."""
        file = self._files.file(claim.key, f"record-{claim.round}.json")
        with told(file):
            file.parent.stat()  # a store that has vanished looks like one with nothing in it
            history = self._files.of(claim.key)
            if not _is_last(claim, history) or not publish(file, record.encoded()):
                return False
            for name in history.passing:
                (file.parent / name).unlink(missing_ok=True)
        return True

    def holds(self, claim: Claim) -> bool:
        """Whether a claim is still the last one of an open case, and nobody has taken it over."""
        return _is_last(claim, self._files.of(claim.key))

    def release(self, claim: Claim) -> None:
        """Give a case back unfinished; what its run has saved stays, and its process has not died with it."""
        file = self._files.file(claim.key, f"released-{claim.round}-{claim.attempt}")
        with told(file):
            create(file, b"")

    def crashed(self, claim: Claim, how: str) -> None:
        """Note that the process of a claim, which is known to have ended, crashed with the case."""
        file = self._files.file(claim.key, f"crashed-{claim.round}-{claim.attempt}.json")
        with told(file):
            create(file, json.dumps({"how": how}).encode())

    def retry(self, key: str) -> bool:
        """Open a case that failed again: its record stays, its runs go. Tells whether that was done."""
        history = self._files.of(key)
        record = self._read_record(key, history)
        if record is None or record.converged or not self._reopen(key, history, "it failed"):
            return False
        for run in self._runs(key, history.round):
            shutil.rmtree(run, ignore_errors=True)
        return True

    def states(self, keys: Iterable[str]) -> dict[str, State]:
        """Where each case stands; takes nothing, and costs one scan of a directory for each first two digits."""
        return {key: self._state(key, history) for key, history in self._files.of_all(keys).items()}

    def _state(self, key: str, history: History) -> State:
        if history.finished:
            return State("finished")
        if not history.is_claimed:
            return State("open", died=history.unreleased)
        holder, since = self._last_claim(key, history)
        if self._is_dead(holder, key, history):
            return State("open", died=history.unreleased)
        living = holder is not None and self._watch.is_living(holder)
        return State("running", str(holder or "unknown"), since, history.unreleased - 1, living)

    def _is_held(self, key: str, history: History) -> bool:
        """Whether somebody who is, or may be, alive works on an open case."""
        return history.is_claimed and not self._is_dead(self._last_claim(key, history)[0], key, history)

    def _is_dead(self, holder: Identity | None, key: str, history: History) -> bool:
        if holder is None:
            return self._watch.is_abandoned(f"{key}, round {history.round}, claim {history.claims}")
        return self._watch.is_dead(holder)

    def _last_claim(self, key: str, history: History) -> tuple[Identity | None, str]:
        """Who made it, and when; no one where it is damaged, or has gone since."""
        file = self._files.file(key, f"claim-{history.round}-{history.claims}.json")
        with told(file):
            try:
                content = json.loads(file.read_bytes())
                return Identity.from_json(content["holder"]), str(content["since"])
            except (FileNotFoundError, ValueError, KeyError, TypeError):
                return None, ""

    def _lost(self, key: str, history: History) -> int:
        """How many claims ended without a word of the supervisor that they had."""
        lost = 0
        for number in {*range(1, history.claims + 1)} - history.released - history.crashed:
            file = self._files.file(key, f"claim-{history.round}-{number}.json")
            with told(file), contextlib.suppress(FileNotFoundError, ValueError, AttributeError):
                lost += json.loads(file.read_bytes()).get("supervised") is True
        return lost

    def _crashes(self, key: str, history: History) -> tuple[str, ...]:
        found = []
        for number in sorted(history.crashed):
            file = self._files.file(key, f"crashed-{history.round}-{number}.json")
            with told(file):
                try:
                    found.append(str(json.loads(file.read_bytes())["how"]))
                except (FileNotFoundError, ValueError, KeyError, TypeError):
                    found.append("it is not known how")
        return tuple(found)

    def _read_record(self, key: str, history: History) -> CaseRecord | None:
        if not history.finished:
            return None
        file = self._files.file(key, f"record-{history.round}.json")
        with told(file):
            try:
                return CaseRecord.decoded(file.read_bytes())
            except ValueError as error:
                why = f"its record is damaged: {error}"
        with contextlib.suppress(OutputError):  # for who may only read the store it is open all the same
            self._reopen(key, history, why)
        return None

    def _reopen(self, key: str, history: History, why: str) -> bool:
        """Begin the next round; ``False`` if another has."""
        file = self._files.file(key, f"reopened-{history.round + 1}.json")
        with told(file):
            return publish(file, json.dumps({"why": why}).encode())

    def _runs(self, key: str, number: int) -> list[Path]:
        """The run directories of a round, the latest last."""
        runs = self.directory(key).glob(f"run-{number}-*")
        return sorted(runs, key=lambda run: int(run.name.rpartition("-")[2]))

    def _take_over(self, claim: Claim, before: History) -> None:
        """Make what earlier attempts have saved our own; one of them who wakes up finds no place to write to."""
        with told(claim.run):
            if runs := self._runs(claim.key, claim.round):
                runs[-1].rename(claim.run)
            holder, _ = self._last_claim(claim.key, before)
            if before.is_claimed and holder is not None:
                self._watch.remove_heartbeat(holder)


def ledger_of(store: Path) -> Ledger:
    """The ledger of a store, for reading."""
    return Ledger(store, Holder(store))


def _is_last(claim: Claim, history: History) -> bool:
    """Whether a case is open and a claim the last on it."""
    return not history.finished and (history.round, history.claims) == (claim.round, claim.attempt)
