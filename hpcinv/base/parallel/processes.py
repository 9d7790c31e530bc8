"""Identity of a process among all processes of all machines, and the start time of processes of this machine."""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Identity:
    """Identity of a process, unique over all hosts and times.

    Attributes:
        token: unique name.
        host: name of the host, for messages.
        machine: identity of the running system to which process numbers refer; "" if unknown.
        pid: process number.
        started: start of the process, in ticks since the system was booted.
        job: cluster and job of Slurm; "" outside Slurm.
        restart: number of times that Slurm has requeued the job.
    """

    token: str
    host: str
    machine: str
    pid: int
    started: str
    job: str
    restart: int

    @classmethod
    def current(cls, environment: Mapping[str, str] = os.environ) -> Identity:
        host, pid = os.uname().nodename, os.getpid()
        job = environment.get("SLURM_JOB_ID", "")  # different for each task of an array
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
        """Identity from `as_json`; raises ``ValueError`` if the data are not valid."""
        try:
            values = {field.name: data[field.name] for field in fields(cls)}
        except (KeyError, TypeError) as error:
            raise ValueError("it names no holder") from error
        if any(type(values[field.name]).__name__ != field.type for field in fields(cls)):
            raise ValueError("it has entries of another type")
        return cls(**values)

    def runs(self, other: Identity) -> bool | None:
        """Return whether another process runs; ``None`` if that is not known here, as of another machine."""
        if other.machine and other.machine == self.machine and (started := start_of(other.pid)) is not None:
            return started == other.started
        is_requeued = other.job and other.job == self.job and other.restart < self.restart
        return False if is_requeued else None

    def as_json(self) -> dict[str, Any]:
        return asdict(self)

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}" + (f" (job {self.job.rpartition('/')[2]})" if self.job else "")


def start_of(pid: int) -> str | None:
    """Start of a process of this machine, in ticks since boot; "" if it has ended, ``None`` if unknown."""
    try:
        status = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return ""
        except OSError:  # a process of another user, which the system hides
            return None
        return None
    return "" if status[0] in "ZX" else status[19]  # Z and X: zombie and dead


def _this_machine(host: str) -> str:
    """Host, boot and namespace of process numbers (containers have their own); "" if unknown."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{host} {boot} {Path('/proc/self/ns/pid').readlink()}"
    except OSError:
        return ""
