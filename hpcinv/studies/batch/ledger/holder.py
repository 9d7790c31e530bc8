"""Holder of claims: a process that works on cases, and its heartbeat.

While it works, its *heartbeat* changes every few seconds: a file ``holders/TOKEN`` with a number that grows. It is
written by a small child process, since a factorization may hold Python's interpreter lock for minutes, which would
block a thread. The child ends whenever its parent ends.
"""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Self

from hpcinv.base.files.atomic import create
from hpcinv.base.parallel.processes import Identity
from hpcinv.base.parallel.signals import signals_blocked
from hpcinv.studies.batch.ledger.store import HEARTBEATS, as_output_error, open_store

BEAT = 5.0  # seconds; a fraction of the lease

# The program overwrites the file in place, so that a full disk does not stop it.
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
    """This process as a holder of claims in a store; its heartbeat is written within the context.

    Raises:
        OutputError: the store cannot be written.
    """

    def __init__(self, store: Path, *, beat: float = BEAT) -> None:
        self.identity = Identity.current()
        self.heartbeat = store / HEARTBEATS / self.identity.token
        self._store, self._beat = store, beat
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def is_beating(self) -> bool:
        return self._process is not None

    def __enter__(self) -> Self:
        open_store(self._store)
        with as_output_error(self.heartbeat):
            create(self.heartbeat, b"%020d" % 1)
        path, parent = str(self.heartbeat.resolve()), str(os.getpid())
        # The child inherits this: signals to all processes of a job must not end it.
        with signals_blocked(signal.valid_signals()):
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", "-c", _HEARTBEAT, path, parent, str(self._beat)],
                stdin=subprocess.DEVNULL,  # the child must keep nothing open that mpirun waits for
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
        with contextlib.suppress(OSError):  # other processes will find that it does not change any more
            self.heartbeat.unlink(missing_ok=True)
