"""View of a store: log, shards and heartbeats as one process has read them, and what follows for each case."""

from pathlib import Path

from hpcinv.base.parallel.processes import Identity
from hpcinv.studies.batch.ledger.claims import CaseState, Claim
from hpcinv.studies.batch.ledger.history import Histories, History, Mark
from hpcinv.studies.batch.ledger.liveness import Watch
from hpcinv.studies.batch.ledger.log import Log
from hpcinv.studies.batch.ledger.records import Records
from hpcinv.studies.batch.ledger.store import LOG, RUNS


class View:
    """View of a store of a process ``me``.

    Args:
        lease: seconds within which the heartbeat of a holder elsewhere must change.
    """

    def __init__(self, store: Path, me: Identity, lease: float) -> None:
        self.store = store
        self.log, self.histories = Log(store / LOG, lease), Histories()
        self.records = Records(store, me.token, self.histories)
        self.watch = Watch(store, me, lease)
        self._is_begun = False

    def directory(self, key: str) -> Path:
        """Return the directory of the runs of a case; ``claim.run`` is the directory of one claim."""
        return self.store / RUNS / key[:2] / key

    def read(self) -> None:
        self.read_log()
        self.records.read_all()

    def read_log(self) -> None:
        if not self._is_begun:
            self.records.read_earlier()
            self._is_begun = True
        for entry in self.log.new_entries():
            self.histories.add(entry)

    def may_claim(self, key: str) -> bool:
        """Return whether a case is open and has no holder who is, or may be, alive."""
        history = self.histories.of(key)
        if self.records.is_finished(key):
            self.records.whole(key)  # raises if another version wrote it
            return bool(self.records.damage(key))
        if self.records.damage(key):
            return True
        if self._is_held(history):
            return False
        self.records.read({*history.holders})
        return not self.records.is_finished(key)

    def claim_of(self, key: str, *released: Mark) -> Claim:
        """Return the next claim of a case that can be claimed, where some claims are released with it."""
        history = self.histories.of(key)
        if self.records.damage(key):
            history = History(history.round + 1)
        gone = {*history.released, *(claim for *case, claim in released if case == [key, history.round])}
        history = history._replace(released=frozenset(gone))
        ended = {*range(1, history.claims + 1)} - gone - {claim for claim, _ in history.crashed}
        lost = sum(history.holders[claim - 1] in self.histories.supervised for claim in ended)
        attempt = history.claims + 1
        run = self.directory(key) / f"run-{history.round}-{attempt}"
        crashes = tuple(how for _, how in sorted(history.crashed))
        return Claim(key, history.round, attempt, history.unreleased - lost, run, crashes, lost)

    def next_round(self, key: str) -> tuple[str, int, int]:
        """Return key and number of the next round of a case, and the claim whose record counts in this one."""
        return key, self.histories.of(key).round + 1, self.records.counted_claim(key)

    def never_begun(self, key: str) -> Mark | None:
        """Return the last claim of a case whose holder is dead and has never begun the case."""
        history = self.histories.of(key)
        return (key, history.round, history.claims) if history.is_claimed and self._waits(key, history) else None

    def _waits(self, key: str, history: History) -> bool:
        """Return whether the holder of the last claim of an open case works, or died, on another case of the block."""
        mark = key, history.round, history.claims
        block = self.histories.blocks.get(history.holders[-1], [])
        return mark in block and next(filter(self.records.is_unfinished_claim, block), None) != mark

    def rest_of_block(self, key: str) -> list[Mark]:
        """Return the last claims of unfinished cases in the block of the last claim of a case, without this case."""
        block = self.histories.blocks.get(self.histories.of(key).holders[-1], [])
        last = filter(self.histories.is_last, filter(self.records.is_unfinished_claim, block))
        return [mark for mark in last if mark[0] != key]

    def state(self, key: str) -> CaseState:
        if self.records.is_finished(key):
            return CaseState("finished")
        history = self.histories.of(key)
        if not history.is_claimed or self.records.damage(key):
            return CaseState("open", died=history.unreleased)
        waits = self._waits(key, history)
        died = history.unreleased - waits
        if self.is_dead(history.holders[-1]):
            return CaseState("open", died=died)
        holder = self.histories.identities[history.holders[-1]]
        return CaseState("running", str(holder), history.unreleased - 1, self.watch.is_living(holder), waits)

    def _is_held(self, history: History) -> bool:
        return history.is_claimed and not self.is_dead(history.holders[-1])

    def is_dead(self, token: str) -> bool:
        identity = self.histories.identities.get(token)
        return identity is None or self.watch.is_dead(identity)

    def is_last(self, claim: Claim) -> bool:
        """Return whether a case is open and a claim is its last one."""
        return not self.records.is_finished(claim.key) and self.histories.is_last(claim.mark)
