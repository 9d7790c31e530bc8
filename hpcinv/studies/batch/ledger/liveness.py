"""Liveness of holders, without comparing the clocks of different machines.

- A process of this machine: the operating system has the answer.
- A process of this Slurm job before it was requeued: dead.
- Any other process: its heartbeat must change within the *lease*, which is measured by the monotonic clock of this
  process. Times of files and of other hosts are never compared, so that clocks may differ by hours.
"""

import os
from pathlib import Path
from time import monotonic

from hpcinv.base.parallel.processes import Identity
from hpcinv.studies.batch.ledger.store import HEARTBEATS, as_output_error

LEASE = 60.0
"""Seconds within which the heartbeat of a holder elsewhere must change; many times `holder.BEAT`."""


class Watch:
    """Observer of heartbeats: the last value of each, and the time since when it has not changed.

    Args:
        lease: seconds.
    """

    def __init__(self, store: Path, me: Identity, lease: float) -> None:
        self._heartbeats, self._me, self._lease = store / HEARTBEATS, me, lease
        self._seen: dict[str, tuple[bytes | None, float]] = {}
        self._beating: set[str] = set()  # tokens whose heartbeat has changed

    def is_dead(self, other: Identity) -> bool:
        """Return whether a process is certainly dead, or its heartbeat has not changed within the lease."""
        if (runs := self._me.runs(other)) is not None:
            return not runs
        return self._is_unchanged(other.token, self._beat(other.token))

    def is_living(self, other: Identity) -> bool:
        """Return whether a process is certainly alive, or was at the last call of `is_dead`; never both."""
        runs = self._me.runs(other)
        return other.token in self._beating if runs is None else runs

    def heartbeat_count(self) -> int:
        """Return the number of heartbeats, also of dead processes."""
        with as_output_error(self._heartbeats):
            return sum(1 for _ in os.scandir(self._heartbeats))

    def remove_heartbeat(self, dead: Identity) -> None:
        """Remove the heartbeat of a dead process; if it is alive after all, it writes the file again."""
        (self._heartbeats / dead.token).unlink(missing_ok=True)

    def _is_unchanged(self, name: str, beat: bytes | None) -> bool:
        now = monotonic()
        seen = self._seen.get(name)
        if seen is None or seen[0] != beat:
            self._seen[name] = (beat, now)
            if seen is not None:
                self._beating.add(name)
            return False
        if unchanged := now - seen[1] >= self._lease:
            self._beating.discard(name)
        return unchanged

    def _beat(self, token: str) -> bytes | None:
        try:
            return (self._heartbeats / token).read_bytes()
        except FileNotFoundError:
            return None
