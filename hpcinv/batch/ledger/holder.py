"""Who works on cases: a process, by what others can tell whether it is still there.

While it works, its *heartbeat* changes every few seconds: a file ``holders/TOKEN`` with a number that grows. It is
written by a small process beside, since a factorization may hold Python's interpreter lock for minutes, and a thread
would starve. That process ends with the one it belongs to, by whatever end.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from hpcinv.batch.ledger.store import heartbeats_in, open_store, told
from hpcinv.files.atomic import create
from hpcinv.parallel.processes import Identity

BEAT = 5.0  # seconds; a fraction of the lease

# It overwrites in place, so that a full disk does not stop it.
_HEARTBEAT = """
import os, sys, time
path, parent, beat = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
count, due = 1, time.monotonic() + beat
while os.getppid() == parent:
    if time.monotonic() >= due:
        count, due = count + 1, time.monotonic() + beat
        try:
            file = os.open(path, os.O_WRONLY | os.O_CREAT)
            try:
                os.pwrite(file, b"%020d" % count, 0)
            finally:
                os.close(file)
        except OSError:
            pass
    time.sleep(min(1.0, beat / 4))
try:
    os.unlink(path)
except OSError:
    pass
"""


class Holder:
    """This process as one that may hold claims in a store; use it as a context, which keeps its heartbeat going.

    Raises:
        OutputError: the store cannot be written.
    """

    def __init__(self, store: Path, *, beat: float = BEAT) -> None:
        self.identity = Identity.of_this_process()
        self.heartbeat = heartbeat_of(self.identity.token, store)
        self._store, self._beat = store, beat
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def is_beating(self) -> bool:
        return self._process is not None

    def __enter__(self) -> Holder:
        open_store(self._store)
        with told(self.heartbeat):
            create(self.heartbeat, b"%020d" % 1)
        path, parent = str(self.heartbeat.resolve()), str(os.getpid())
        with _signals_blocked():  # it inherits that: signals to all processes of a job must not end it
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", "-c", _HEARTBEAT, path, parent, str(self._beat)],
                stdin=subprocess.DEVNULL,  # it must keep nothing open that mpirun waits for
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                cwd="/",
                start_new_session=True,
            )
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process is not None
        self._process.kill()
        self._process.wait()
        self._process = None
        with contextlib.suppress(OSError):  # others will find that it does not change any more
            self.heartbeat.unlink(missing_ok=True)


@contextlib.contextmanager
def _signals_blocked() -> Iterator[None]:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def heartbeat_of(token: str, store: Path) -> Path:
    return heartbeats_in(store) / token
