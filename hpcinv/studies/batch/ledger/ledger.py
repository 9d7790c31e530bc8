"""Ledger of a store: finished cases, and the processes that work on others, in any number of allocations at once.

The state of a case is the set of its files. Each is created once, whole and exclusively (`atomic`), and never
changed:

- ``KEY.claim-R-N.json``: claim N in round R, and its holder; ``KEY.released-R-N``: it was released.
- ``KEY.crashed-R-N.json``: its process crashed, and how, as its supervisor noted.
- ``KEY.record-R.json``: how the case ended. A round has one at most.
- ``KEY.reopened-R.json``: round R has begun, since the record of the round before is damaged, or its case is to be
  tried again. Round 1 has no such file.

Reading writes nothing: a case with a damaged record is opened again when it is claimed, or when a sweep starts.

A case is finished if its latest round has a record. Else it is open; it is held if its last claim was not released and
the holder of that is not dead (`liveness`).

**Nothing is done twice.** *While a round is open, its last claim is not removed*: claims are removed after the record
is written. To claim a case, a process reads the files, finds that claim N was released or that its holder is dead,
creates claim N + 1 exclusively, and reads the files again: the round must still be the latest, with no record and no
later claim. The first reading has found all claims, unless they were being removed; but then there was a record, which
the second reading finds. So the claims of an open round are a chain: each is made by one process, after the one before
has ended. A process that was taken for dead and continues finds, when it commits, that its claim is not the last, and
when it saves, that its run directory was renamed. If it commits at the same time as its successor, one of them creates
the record, and `commit` returns ``False`` to the other.

**Nothing is lost.** Whenever a process is killed, it leaves nothing, a partial file with a unique name, a claim without
a living holder, or a whole record. None of these has to be repaired. The checkpoints of its run are in the run
directory, which the next claim renames.
"""

import contextlib
import json
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from hpcinv.base.files.atomic import create, make_directory, publish
from hpcinv.base.files.inputs import changed_inputs
from hpcinv.base.files.saved_mark import mark_saved
from hpcinv.base.parallel.processes import Identity
from hpcinv.errors import OutputError
from hpcinv.studies.batch.ledger.case_record import CaseRecord, OtherVersionError
from hpcinv.studies.batch.ledger.history import Histories, History
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.liveness import LEASE, Watch
from hpcinv.studies.batch.ledger.store import RUNS, as_output_error, check_format

DEADLY = 5
"""Number of processes that died with a case after which the case has failed.

A process can also die with its allocation, so one or two deaths do not mean that the case is the cause.
"""

LOST = 25
"""Number of processes that died together with their supervisor after which the case has failed.

A supervisor survives a crash of its case, so this is most likely a kill of the whole allocation.
"""

KILLED = "ended by SIGKILL"
"""End of a process that was killed, perhaps since another process has used up the memory."""

CRASHES = 2
"""Number of crashes, noted by a supervisor, after which the case has failed."""


@dataclass(frozen=True)
class Claim:
    """The right to work on a case.

    Attributes:
        round, attempt: number of the round, and of the claim in it, both from 1.
        died: number of earlier attempts that ended with their process.
        lost: number of further attempts that ended together with their supervisor.
        crashes: for each earlier attempt that crashed its process, how the process ended.
        run: directory of checkpoints and results, also of earlier attempts; it need not exist.
    """

    key: str
    round: int
    attempt: int
    died: int
    run: Path
    crashes: tuple[str, ...] = ()
    lost: int = 0


@dataclass(frozen=True)
class CaseState:
    """State of a case.

    Attributes:
        holder: the process that works on it, for display.
        died: number of attempts at an open case that ended with their process.
        living: whether it is certain that the holder is alive.
    """

    name: Literal["open", "running", "finished"]
    holder: str = ""
    died: int = 0
    living: bool = False


class Ledger:
    """Access of one process to the cases of a store.

    Args:
        lease: seconds within which the heartbeat of a holder elsewhere must change.
        supervised: whether a supervisor notes the crashes of this process.
        home_of: returns the directory of the program that makes the mesh of a case, by its key, if that is known. A
            record whose mesh was made from files with another content than they have there now counts as damaged.

    Raises:
        OutputError: from every method, where the file system fails; no half-written file is left. From methods that
            read records, where another version of hpcinv wrote one that cannot be read.
    """

    def __init__(
        self,
        path: Path,
        holder: Holder,
        *,
        lease: float = LEASE,
        supervised: bool = False,
        home_of: Callable[[str], Path | None] = lambda key: None,
    ) -> None:
        self.path, self.holder, self.lease, self.supervised = path, holder, lease, supervised
        self.home_of = home_of
        self._files, self._watch = Histories(path), Watch(path, holder.identity, lease)

    def directory(self, key: str) -> Path:
        """Return the directory of the runs of a case; ``claim.run`` is the directory of one claim."""
        return self.path / RUNS / key[:2] / key

    def record(self, key: str) -> CaseRecord | None:
        """Return the record of a case; ``None`` if it is not finished, or its record is damaged."""
        return self._read_record(key, self._files.history(key))

    def records(self, keys: Iterable[str]) -> Iterator[tuple[str, CaseRecord]]:
        """Yield key and record of each case that is finished and not damaged, with few directory scans."""
        for key, history in self._files.histories(keys).items():
            if (record := self._read_record(key, history)) is not None:
                yield key, record

    def damaged(self, keys: Iterable[str]) -> list[str]:
        """Return the keys of cases whose record is damaged, so that they count as open."""
        return [key for key, history in self._files.histories(keys).items() if self._damage(key, history)]

    def reopen_damaged(self, keys: Iterable[str]) -> int:
        """Open the cases with damaged records again, as `claim` does; return their number."""
        return sum(self._reopen_damaged(key, history) for key, history in self._files.histories(keys).items())

    def claim(self, key: str) -> Claim | None:
        """Claim a case; return ``None`` at once if it is finished or its holder is, or may be, alive.

        A case with a damaged record is opened again.
        """
        assert self.holder.is_beating
        history = self._files.history(key)
        if self._reopen_damaged(key, history):
            history = self._files.history(key)
        if history.finished or self._is_held(key, history):
            return None
        attempt = history.claims + 1
        file = self._files.file(key, f"claim-{history.round}-{attempt}.json")
        content = {
            "holder": self.holder.identity.as_json(),
            "since": datetime.now(UTC).isoformat(timespec="seconds"),
            "supervised": self.supervised,
        }
        with as_output_error(file):
            make_directory(file.parent)
            if not create(file, json.dumps(content).encode()):
                return None
        run = self.directory(key) / f"run-{history.round}-{attempt}"
        lost = self._lost(key, history)
        claim = Claim(key, history.round, attempt, history.unreleased - lost, run, self._crashes(key, history), lost)
        if not _is_last(claim, self._files.history(key)):
            with as_output_error(file):
                file.unlink(missing_ok=True)
            return None
        if attempt > 1:
            self._take_over(claim, history)
        return claim

    def commit(self, claim: Claim, record: CaseRecord) -> bool:
        """Write the record of a claimed case; ``False`` if another process has claimed or recorded the case."""
        file = self._files.file(claim.key, f"record-{claim.round}.json")
        with as_output_error(file):
            file.parent.stat()  # raises if the store was removed, which otherwise looks like an empty one
            history = self._files.history(claim.key)
            if not _is_last(claim, history) or not publish(file, record.encoded()):
                return False
            for name in history.temporary:
                (file.parent / name).unlink(missing_ok=True)
        mark_saved()
        return True

    def holds(self, claim: Claim) -> bool:
        """Return whether a claim is still the last one of an open case."""
        return _is_last(claim, self._files.history(claim.key))

    def release(self, claim: Claim) -> None:
        """Release an unfinished case; its checkpoints are kept, and the claim does not count as died."""
        file = self._files.file(claim.key, f"released-{claim.round}-{claim.attempt}")
        with as_output_error(file):
            create(file, b"")

    def crashed(self, claim: Claim, how: str) -> None:
        """Note that the process of a claim, which is known to have ended, crashed with the case."""
        file = self._files.file(claim.key, f"crashed-{claim.round}-{claim.attempt}.json")
        with as_output_error(file):
            create(file, json.dumps({"how": how}).encode())

    def retry(self, key: str) -> bool:
        """Open a failed case again: its record is kept, its runs are removed. Return whether that was done."""
        history = self._files.history(key)
        record = self._read_record(key, history)
        if record is None or record.converged or not self._reopen(key, history, "it failed"):
            return False
        for run in self._runs(key, history.round):
            shutil.rmtree(run, ignore_errors=True)
        return True

    def states(self, keys: Iterable[str]) -> dict[str, CaseState]:
        """Return the state of each case; claims nothing, and scans few directories."""
        return {key: self._state(key, history) for key, history in self._files.histories(keys).items()}

    def _state(self, key: str, history: History) -> CaseState:
        if history.finished:
            return CaseState("finished")
        if not history.is_claimed:
            return CaseState("open", died=history.unreleased)
        holder = self._last_holder(key, history)
        if self._is_dead(holder, key, history):
            return CaseState("open", died=history.unreleased)
        living = holder is not None and self._watch.is_living(holder)
        return CaseState("running", str(holder or "unknown"), history.unreleased - 1, living)

    def _is_held(self, key: str, history: History) -> bool:
        """Return whether an open case has a holder who is, or may be, alive."""
        return history.is_claimed and not self._is_dead(self._last_holder(key, history), key, history)

    def _is_dead(self, holder: Identity | None, key: str, history: History) -> bool:
        if holder is None:
            return self._watch.is_abandoned(f"{key}, round {history.round}, claim {history.claims}")
        return self._watch.is_dead(holder)

    def _last_holder(self, key: str, history: History) -> Identity | None:
        """Return the holder of the last claim; ``None`` if the claim is damaged or was removed meanwhile."""
        with contextlib.suppress(ValueError):
            return Identity.from_json(self._entry(key, f"claim-{history.round}-{history.claims}", "holder"))
        return None

    def _lost(self, key: str, history: History) -> int:
        """Return the number of claims that ended without a note of the supervisor that they had."""
        ended = {*range(1, history.claims + 1)} - history.released - history.crashed
        return sum(self._entry(key, f"claim-{history.round}-{number}", "supervised") is True for number in ended)

    def _crashes(self, key: str, history: History) -> tuple[str, ...]:
        reasons = (self._entry(key, f"crashed-{history.round}-{number}", "how") for number in sorted(history.crashed))
        return tuple("not known how" if how is None else str(how) for how in reasons)

    def _entry(self, key: str, name: str, entry: str) -> Any:
        """Return an entry of one of a case's files; ``None`` if the file is damaged or was removed meanwhile."""
        file = self._files.file(key, f"{name}.json")
        with as_output_error(file), contextlib.suppress(FileNotFoundError, ValueError, KeyError, TypeError):
            return json.loads(file.read_bytes())[entry]
        return None

    def _read_record(self, key: str, history: History) -> CaseRecord | None:
        if not history.finished:
            return None
        with contextlib.suppress(ValueError):
            return self._decoded(key, history)
        return None

    def _decoded(self, key: str, history: History) -> CaseRecord:
        """Return the record of a finished case; raise ``ValueError`` if it is damaged, or a file of its mesh changed.

        Raises:
            OutputError: another version wrote it, so that the case must not be solved again in its place.
        """
        file = self._files.file(key, f"record-{history.round}.json")
        try:
            with as_output_error(file):
                record = CaseRecord.decoded(file.read_bytes())
            if (home := self.home_of(key)) is not None and (changed := changed_inputs(record.inputs, home)):
                raise ValueError(f"{home / changed[0]} has changed since the mesh was made from it")
            return record
        except OtherVersionError as error:
            raise OutputError(
                f"{file}: another version of hpcinv wrote it: {error}",
                "Use that version, or choose another 'store'; nothing was changed.",
            ) from None

    def _damage(self, key: str, history: History) -> str:
        """Return in what way the record of a case is damaged; empty if it is not, or there is none."""
        try:
            if history.finished:
                self._decoded(key, history)
        except ValueError as error:
            return str(error)
        return ""

    def _reopen_damaged(self, key: str, history: History) -> bool:
        why = self._damage(key, history)
        return bool(why) and self._reopen(key, history, f"its record cannot be used: {why}")

    def _reopen(self, key: str, history: History, why: str) -> bool:
        """Begin the next round; ``False`` if another process has done so."""
        file = self._files.file(key, f"reopened-{history.round + 1}.json")
        with as_output_error(file):
            return publish(file, json.dumps({"why": why}).encode())

    def _runs(self, key: str, number: int) -> list[Path]:
        runs = self.directory(key).glob(f"run-{number}-*")
        return sorted(runs, key=lambda run: int(run.name.rpartition("-")[2]))

    def _take_over(self, claim: Claim, history: History) -> None:
        """Rename the run directory of earlier attempts to the claim's, so that they can no longer write to it."""
        with as_output_error(claim.run):
            if runs := self._runs(claim.key, claim.round):
                runs[-1].rename(claim.run)
            holder = self._last_holder(claim.key, history)
            if history.is_claimed and holder is not None:
                self._watch.remove_heartbeat(holder)


def ledger_of(store: Path, home_of: Callable[[str], Path | None] = lambda key: None) -> Ledger:
    """Return the ledger of a store, for reading; ``home_of`` as for `Ledger`.

    Raises:
        OutputError: the store has another format.
    """
    check_format(store)
    return Ledger(store, Holder(store), home_of=home_of)


def _is_last(claim: Claim, history: History) -> bool:
    """Return whether a case is open and a claim is its last one."""
    return not history.finished and (history.round, history.claims) == (claim.round, claim.attempt)
