"""Access of a process to the cases of a store: it claims them, commits their records, and reads all."""

import random
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from hpcinv.base.files.inputs import changed_inputs, digest_of
from hpcinv.base.files.saved_mark import mark_saved
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.claims import CaseState, Claim
from hpcinv.studies.batch.ledger.history import Mark
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.liveness import LEASE
from hpcinv.studies.batch.ledger.store import as_output_error, check_format
from hpcinv.studies.batch.ledger.view import View


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
        self._view = View(path, holder.identity, lease)
        self._held: dict[Mark, Claim] = {}

    def directory(self, key: str) -> Path:
        """Return the directory of the runs of a case; ``claim.run`` is the directory of one claim."""
        return self._view.directory(key)

    def record(self, key: str) -> CaseRecord | None:
        """Return the record of a case; ``None`` if it is not finished, or its record is damaged."""
        return dict(self.records([key])).get(key)

    def records(self, keys: Iterable[str]) -> Iterator[tuple[str, CaseRecord]]:
        """Yield key and record of each case that is finished and not damaged."""
        self._view.read()
        whole = ((key, record) for key in keys if (record := self._view.records.whole(key)) is not None)
        return self._usable(whole)

    def briefs(self, keys: Iterable[str]) -> Iterator[tuple[str, CaseRecord]]:
        """Yield the same with `CaseRecord.brief` of each record, which takes less time and memory."""
        self._view.read()
        return self._usable(self._view.records.briefs(keys))

    def damaged(self, keys: Iterable[str]) -> list[str]:
        """Return the keys of cases whose record is damaged, so that they count as open."""
        self._view.read()
        return [*self._damages(keys)]

    def reopen_damaged(self, keys: Iterable[str]) -> int:
        """Open the cases with damaged records again, as `claim` does; return their number."""
        keys = [*keys]

        def entry() -> dict[str, Any] | None:
            self._view.read()
            damages = self._damages(keys)
            reopened = [self._view.next_round(key) for key in damages]
            return {"reopened": reopened, "why": [*damages.values()]} if reopened else None

        added = self._add(entry)
        return 0 if added is None else len(added["reopened"])

    def claim(self, key: str) -> Claim | None:
        """Claim a case; return ``None`` at once if it is finished or its holder is, or may be, alive.

        A case with a damaged record is opened again.
        """
        return next(iter(self.claim_all([key])), None)

    def claim_all(self, keys: Iterable[str]) -> list[Claim]:
        """Claim a block of cases, and return those that can be had; this process works on them in this order."""
        assert self.holder.is_beating
        keys = [*keys]
        claims: list[Claim] = []
        predecessors: list[str] = []

        def entry() -> dict[str, Any] | None:
            self._view.read_log()
            wanted = [key for key in keys if self._view.may_claim(key)]
            reopened = [self._view.next_round(key) for key in wanted if self._view.records.damage(key)]
            released = [mark for key in wanted if (mark := self._view.never_begun(key))]
            claims[:] = [self._view.claim_of(key, *released) for key in wanted]
            predecessors[:] = {token for key in wanted for token in self._view.histories.of(key).holders}
            marks = [claim.mark for claim in claims]
            return self._claims(marks) | {"reopened": reopened, "released": released} if marks else None

        if self._add(entry, gives_up=True) is None:
            return []
        self._view.records.read(predecessors)  # of holders that were taken for dead
        granted = [claim for claim in claims if self._view.is_last(claim)]
        self._held |= {claim.mark: claim for claim in granted}
        for claim in granted:
            if claim.attempt > 1:
                self._take_over(claim)
        return granted

    def commit(self, claim: Claim, record: CaseRecord) -> bool:
        """Write the record of a claimed case; ``False`` if another process has claimed or recorded the case."""
        if claim.mark not in self._held:
            return self._commit_for_holder(claim, record)
        self._view.records.add(claim.mark, record)
        del self._held[claim.mark]
        mark_saved()
        self._view.read_log()
        return self._view.histories.counts(claim.mark)

    def holds(self, claim: Claim) -> bool:
        """Return whether a claim is still the last one of an open case."""
        self._view.read()
        return self._view.is_last(claim)

    def release(self, *claims: Claim) -> None:
        """Release unfinished cases; their checkpoints are kept, and the claims do not count as died.

        Claims of another process, which has ended, are released with the rest of its block.
        """

        def entry() -> dict[str, Any] | None:
            self._view.read()
            released = [claim.mark for claim in claims if self._view.is_last(claim)]
            rest = [mark for key, *_ in released for mark in self._view.rest_of_block(key) if mark not in self._held]
            return {"released": [*dict.fromkeys([*released, *rest])]} if released else None

        self._add(entry)
        for claim in claims:
            self._held.pop(claim.mark, None)

    def close(self) -> None:
        """Release all cases that this process holds, and close its files."""
        self._view.records.close()
        if self._held:
            self.release(*self._held.values())

    def holder_count(self) -> int:
        """Return the number of processes that work on cases of the store, with dead ones that nobody has noticed."""
        return self._view.watch.heartbeat_count()

    def crashed(self, claim: Claim, how: str) -> None:
        """Note that the process of a claim, which is known to have ended, crashed with the case."""

        def entry() -> dict[str, Any]:
            self._view.read_log()
            return {"crashed": [claim.mark], "how": how}

        self._add(entry)

    def retry(self, *keys: str) -> list[str]:
        """Open failed cases again, and return their keys: their records are kept, their runs are removed."""
        rounds: dict[str, int] = {}

        def entry() -> dict[str, Any] | None:
            failed = [key for key, record in self.briefs(keys) if not record.converged]
            rounds.clear()
            rounds.update((key, self._view.histories.of(key).round) for key in failed)
            reopened = [self._view.next_round(key) for key in failed]
            return {"reopened": reopened, "why": "it failed"} if reopened else None

        self._add(entry)
        for key, number in rounds.items():
            for run in runs_in(self.directory(key), number):
                shutil.rmtree(run, ignore_errors=True)
        return [*rounds]

    def states(self, keys: Iterable[str]) -> dict[str, CaseState]:
        """Return the state of each case; claims nothing."""
        self._view.read()
        return {key: self._view.state(key) for key in keys}

    def _add(self, entry: Callable[[], dict[str, Any] | None], *, gives_up: bool = False) -> dict[str, Any] | None:
        """Add an entry to the log, made anew whenever another process was faster; ``None`` if there is none to add.

        Args:
            gives_up: whether to return ``None`` while the entry of another process is incomplete.
        """
        attempt = 0
        while (content := entry()) is not None and not self._view.log.add(content):
            length = self._view.log.length
            self._view.read_log()
            if gives_up and self._view.log.length == length:
                return None
            attempt += 1
            time.sleep(random.uniform(0, min(0.001 * 2**attempt, 0.5)))
        if content is not None:
            self._view.read_log()
        return content

    def _commit_for_holder(self, claim: Claim, record: CaseRecord) -> bool:
        """Write the record of a claim of another process, whose supervisor this process is: as its successor."""
        own = claim.key, claim.round, claim.attempt + 1

        def entry() -> dict[str, Any] | None:
            self._view.read()
            rest = self._view.rest_of_block(claim.key)
            return self._claims([own]) | {"released": rest} if self._view.is_last(claim) else None

        if self._add(entry) is None:
            return False
        self._view.records.read_all()
        if self._view.records.is_finished(claim.key):
            return False
        self._view.records.add(own, record)
        self._view.read_log()
        return self._view.histories.counts(own)

    def _claims(self, marks: list[Mark]) -> dict[str, Any]:
        """Return an entry of the log in which this process claims cases."""
        return {
            "holder": self.holder.identity.as_json(),
            "since": datetime.now(UTC).isoformat(timespec="seconds"),
            "supervised": self.supervised,
            "claims": marks,
        }

    def _usable(self, records: Iterable[tuple[str, CaseRecord]]) -> Iterator[tuple[str, CaseRecord]]:
        """Yield the records whose meshes were made from the files that are there now."""
        digest = cache(digest_of)
        for key, record in records:
            if not self._changed_input(key, record, digest):
                yield key, record

    def _changed_input(self, key: str, record: CaseRecord, digest: Callable[[Path], str]) -> str:
        home = self.home_of(key) if (inputs := record.inputs) else None
        changed = [] if home is None else changed_inputs(inputs, home, digest)
        return f"{home / changed[0]} has changed since the mesh was made from it" if home and changed else ""

    def _damages(self, keys: Iterable[str]) -> dict[str, str]:
        """Return in what way the records of cases are damaged, by key; note them as damaged."""
        keys, digest = [*keys], cache(digest_of)
        for key, record in self._view.records.briefs(keys):
            if why := self._changed_input(key, record, digest):
                self._view.records.note_damage(key, why)
        damages = {key: self._view.records.damage(key) for key in keys}
        return {key: f"its record cannot be used: {why}" for key, why in damages.items() if why}

    def _take_over(self, claim: Claim) -> None:
        """Rename the run directory of earlier attempts to the claim's, so that they can no longer write to it."""
        with as_output_error(claim.run):
            if runs := runs_in(self.directory(claim.key), claim.round):
                with suppress(FileNotFoundError):  # a later successor was faster
                    runs[-1].rename(claim.run)
            for token in {*self._view.histories.of(claim.key).holders} - {self.holder.identity.token, ""}:
                if self._view.is_dead(token):
                    self._view.watch.remove_heartbeat(self._view.histories.identities[token])


def ledger_of(store: Path, home_of: Callable[[str], Path | None] = lambda key: None) -> Ledger:
    """Return the ledger of a store, for reading; ``home_of`` as for `Ledger`.

    Raises:
        OutputError: the store has another format.
    """
    check_format(store)
    return Ledger(store, Holder(store), home_of=home_of)


def runs_in(directory: Path, number: int) -> list[Path]:
    """Return the directories of the runs of a round of a case, in the order of its claims."""
    return sorted(directory.glob(f"run-{number}-*"), key=lambda run: int(run.name.rpartition("-")[2]))
