"""Whether a holder is still there, without trust in any clock but our own.

- A process of this machine: the system knows, at once.
- A former run of our own Slurm job, before it was requeued: it is not, at once.
- Any other: its heartbeat must change within the *lease*, while we look. How long we have looked is told by our own
  monotonic clock; times of files and of other hosts are never compared, so that clocks may differ by hours.
"""

from __future__ import annotations

from pathlib import Path
from time import monotonic

from hpcinv.batch.ledger.holder import heartbeat_of
from hpcinv.parallel.processes import Identity, start_of

LEASE = 60.0
"""Seconds within which the heartbeat of a holder elsewhere must change; many times `holder.BEAT`."""


class Watch:
    """Remembers the heartbeats that were seen, and since when each is as it is.

    Args:
        lease: seconds.
    """

    def __init__(self, store: Path, me: Identity, lease: float) -> None:
        self._store, self._me, self._lease = store, me, lease
        self._seen: dict[str, tuple[bytes | None, float]] = {}
        self._beating: set[str] = set()  # whose heartbeat was seen to change

    def is_dead(self, other: Identity) -> bool:
        """Whether it is certain, or the lease has passed, since when nothing of it has changed."""
        me = self._me
        if other.machine and other.machine == me.machine:
            started = start_of(other.pid)
            if started is not None:
                return started != other.started
        if other.job and other.job == me.job and other.restart < me.restart:
            return True
        return self._is_still(other.token, self._beat(other.token))

    def is_living(self, other: Identity) -> bool:
        """Whether it is certain that it lives, or did at the last look; never at once with `is_dead`."""
        if other.machine and other.machine == self._me.machine and (started := start_of(other.pid)) is not None:
            return started == other.started
        return other.token in self._beating

    def remove_heartbeat(self, dead: Identity) -> None:
        """Remove the heartbeat of one who has lost the only case that he had; should he live, he makes it again."""
        heartbeat_of(dead.token, self._store).unlink(missing_ok=True)

    def is_abandoned(self, claim: str) -> bool:
        """The same for the holder of a claim that is damaged: nobody knows who it is."""
        return self._is_still(claim, None)

    def _is_still(self, name: str, beat: bytes | None) -> bool:
        now = monotonic()
        seen = self._seen.get(name)
        if seen is None or seen[0] != beat:
            self._seen[name] = (beat, now)
            if seen is not None:
                self._beating.add(name)
            return False
        if still := now - seen[1] >= self._lease:
            self._beating.discard(name)
        return still

    def _beat(self, token: str) -> bytes | None:
        try:
            return heartbeat_of(token, self._store).read_bytes()
        except FileNotFoundError:
            return None
