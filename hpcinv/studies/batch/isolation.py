"""Isolation of cases in separate processes, so that a case that crashes or never ends affects only its own process.

The processes that the launcher has started are supervisors: they load MPI, but neither PETSc nor users' code. The first
rank of each group starts the processes that solve its cases (`groupprocess`): directly on one rank, by mpiexec on
several. If they crash, it notes that in the ledger and starts them again, and they continue with other cases. A case
that takes longer than its limit stops at the next Newton iteration; where it does not, since it is in code that never
returns, the supervisor writes its record and kills its process.
"""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from hpcinv.base.parallel.children import ending_with_this
from hpcinv.base.parallel.processes import Identity
from hpcinv.base.parallel.ranks import MPI
from hpcinv.base.parallel.signals import StopRequest
from hpcinv.errors import Interrupted, SystemPartMissing
from hpcinv.studies.batch.grouptask import CaseStarted, Ended, EventReader, GroupTask
from hpcinv.studies.batch.ledger.ledger import Ledger, ledger_of

_PAUSE = 0.05  # seconds between checks of a group
_FRUITLESS = 3  # largest number of consecutive starts that end before a case is begun
_STOP = 1  # tag of the message that another rank of the group has received a signal
_OF_LAUNCHERS = ("PMI", "HYD", "MPI_LOCAL", "OMPI_COMM_WORLD", "OMPI_MCA_orte", "OMPI_MCA_ess", "OMPI_UNIVERSE", "PRTE")


def can_isolate(group: MPI.Intracomm) -> bool:
    """Return whether processes can be started for a group: for one rank, or on one machine by mpiexec. Collective."""
    if group.size == 1:
        return True
    identity = Identity.current()
    machines = set(group.allgather(identity.machine or identity.host))
    return len(machines) == 1 and bool(group.bcast(_mpiexec()))


def supervise(task: GroupTask, group: MPI.Intracomm, note: Callable[[str], None], stop: StopRequest) -> None:
    """Solve the cases of a task in separate processes; collective.

    Raises:
        Interrupted: on every rank of the group: a signal was received, and cases are left.
        OutputError, SystemPartMissing: on the first rank: the store cannot be used, or no process can be started.
    """
    mine = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set[int]()
    processors = sorted(set[int]().union(*group.allgather(mine)))
    if group.rank != 0:
        _wait_for_first(group, stop)
        return
    try:
        _Supervisor(task, group, processors, note, stop).run()
    finally:
        group.Ibarrier().Wait()
        while group.Iprobe(tag=_STOP):
            group.recv(tag=_STOP)


def _wait_for_first(group: MPI.Intracomm, stop: StopRequest) -> None:
    everyone, sent = group.Ibarrier(), list[MPI.Request]()
    while not everyone.Test():
        if stop.signal is not None and not sent:
            sent.append(group.isend(int(stop.signal), 0, tag=_STOP))
        time.sleep(_PAUSE)
    MPI.Request.Waitall(sent)


@dataclass
class _Outcome:
    """End of the processes of a group: the last events, the exit code, and whether a case was begun."""

    ended: Ended | None = None
    held: CaseStarted | None = None
    code: int = 0
    begun: bool = False


@dataclass
class _Supervisor:
    """Supervisor of the processes of a group, on its first rank."""

    task: GroupTask
    group: MPI.Intracomm
    processors: Sequence[int]
    note: Callable[[str], None]
    stop: StopRequest

    def __post_init__(self) -> None:
        self.ledger: Ledger = ledger_of(self.task.batch.store)

    def run(self) -> None:
        fruitless = 0
        while True:
            with tempfile.TemporaryDirectory(prefix="hpcinv-") as place:
                outcome = self._supervise(Path(place))
            if outcome.ended is not None:
                if outcome.ended.error is not None:
                    raise outcome.ended.error
                return
            if self._stop_signal() is not None:
                if outcome.held is not None:
                    self.ledger.release(outcome.held.claim)
                raise Interrupted("stopped by a signal")
            how = _how(outcome.code)
            if (held := outcome.held) is not None:
                self.ledger.crashed(held.claim, how)
                self.note(f"{held.title}: crashed its process ({how}); other cases continue in a new process")
            fruitless = 0 if outcome.begun else fruitless + 1
            if fruitless == _FRUITLESS:
                raise SystemPartMissing(
                    f"{_FRUITLESS} times the processes of a group {how} before they began a case",
                    "See what they printed. With --no-isolation the ranks of the launcher solve cases themselves.",
                )

    def _supervise(self, place: Path) -> _Outcome:
        """Start the processes of the group, and supervise them until they end."""
        self.task.write(place)
        reader = EventReader(place)
        process = self._start(place)
        outcome = _Outcome()
        last_event, signalled = time.monotonic(), False
        try:
            while True:
                has_ended = _has_ended(process)  # before its last events are read
                for event in reader.events():
                    if isinstance(event, Ended):
                        outcome.ended = event
                    else:
                        outcome.held, last_event = event, time.monotonic()
                        outcome.begun = True
                if has_ended:
                    outcome.code = process.returncode
                    return outcome
                if not signalled and (received := self._stop_signal()) is not None:
                    signalled = True
                    process.send_signal(received)
                if outcome.held is not None and self._is_stuck(time.monotonic() - last_event):
                    self._record_overdue(outcome.held)
                    outcome.held = None
                    return outcome
        finally:
            _kill(process)
            reader.close()

    def _start(self, place: Path) -> subprocess.Popen[bytes]:
        program = [sys.executable, "-m", "hpcinv.studies.batch.groupprocess", str(place)]
        if self.group.size > 1:
            program = [cast(str, _mpiexec()), "-n", str(self.group.size), *program]
        return subprocess.Popen(
            ending_with_this(program, processors=self.processors),  # of all ranks of its group
            env=_environment(),
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )

    def _stop_signal(self) -> signal.Signals | None:
        if self.stop.signal is None and self.group.Iprobe(tag=_STOP):
            self.stop.signal = signal.Signals(self.group.recv(tag=_STOP))
        return self.stop.signal

    def _is_stuck(self, seconds: float) -> bool:
        """Return whether a case has exceeded its limit by more than it takes to stop by itself."""
        limit = self.task.batch.limit
        return limit is not None and seconds > limit + max(5.0, 0.1 * limit)

    def _record_overdue(self, held: CaseStarted) -> None:
        """Record that a case took too long, before its process ends, so that no other process claims the case."""
        record = self.task.batch.overdue_record(held.claim)
        if self.ledger.commit(held.claim, record):
            self.note(f"{held.title}: {record.status}, and did not stop: its process was killed")


def _how(code: int) -> str:
    """Return how processes ended, in words; mpiexec gives the number of a signal as its exit code."""
    fatal = (signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGKILL)
    if code < 0 or code in fatal:
        with contextlib.suppress(ValueError):
            return f"ended by {signal.Signals(abs(code)).name}"
    return f"ended with exit code {code} before all was done"


def _has_ended(process: subprocess.Popen[bytes]) -> bool:
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(_PAUSE)
    return process.returncode is not None


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kill the remaining processes of a group, which have their own session."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _mpiexec() -> str | None:
    """Return the path of mpiexec, which this Python's MPI has in the same directory."""
    return shutil.which("mpiexec", path=str(Path(sys.executable).parent)) or shutil.which("mpiexec")


def _environment() -> dict[str, str]:
    """Return the environment without a launcher's variables, so that MPI starts again; mpiexec then forks processes."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(_OF_LAUNCHERS)}
    return kept | {"HYDRA_LAUNCHER": "fork", "HYDRA_RMK": "user"}
