"""Who works on cases: a process, by what others can tell whether it is still there.

While it works, its *heartbeat* changes every few seconds: a file ``holders/TOKEN`` with a number that grows. It is
written by a small process beside, since a factorization may hold Python's interpreter lock for minutes, and a thread
would starve. That process ends with the one it belongs to, by whatever end.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from hpcinv.sweep.exclusive import create, told
from hpcinv.sweep.store import heartbeats_in, open_store

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


@dataclass(frozen=True)
class Identity:
    """What tells one process from all others, on any host, of any time.

    Attributes:
        token: its name, never used again.
        host: for people.
        machine: the running system whose process numbers are meant; "" if that cannot be told.
        pid, started: process number, and start in ticks since the system booted.
        job: cluster and job of Slurm; "" outside of it.
        restart: how often Slurm has requeued the job.
    """

    token: str
    host: str
    machine: str
    pid: int
    started: str
    job: str
    restart: int

    @classmethod
    def of_this_process(cls, environment: Mapping[str, str] = os.environ) -> Identity:
        host, pid = os.uname().nodename, os.getpid()
        job = environment.get("SLURM_JOB_ID", "")  # of its own for each task of an array
        return cls(
            token=f"{re.sub(r'[^A-Za-z0-9]', '-', host)}-{pid}-{secrets.token_hex(6)}",
            host=host,
            machine=_this_machine(host),
            pid=pid,
            started=start_of(pid) or "",
            job=f"{environment.get('SLURM_CLUSTER_NAME', '')}/{job}" if job else "",
            restart=int(environment.get("SLURM_RESTART_COUNT", "0")),
        )

    @classmethod
    def from_json(cls, data: Any) -> Identity:
        """Raises ``ValueError`` if it is none."""
        try:
            values = {field.name: data[field.name] for field in fields(cls)}
        except (KeyError, TypeError) as error:
            raise ValueError("it names no holder") from error
        if any(type(values[field.name]).__name__ != field.type for field in fields(cls)):
            raise ValueError("it has entries of another type")
        return cls(**values)

    def as_json(self) -> dict[str, Any]:
        return asdict(self)

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}" + (f" (job {self.job.rpartition('/')[2]})" if self.job else "")


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


def start_of(pid: int) -> str | None:
    """When a process here started, in ticks since boot; "" if it has ended, ``None`` if that cannot be told."""
    try:
        status = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return ""
        except OSError:  # a process of someone else, which the system hides
            return None
        return None
    return "" if status[0] in "ZX" else status[19]  # a zombie works no more


def _this_machine(host: str) -> str:
    """Host, boot, and which process numbers are seen (containers have their own); "" where that cannot be told."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{host} {boot} {Path('/proc/self/ns/pid').readlink()}"
    except OSError:
        return ""
