"""Cases solved in processes of their own, so that one that crashes, or never ends, takes only its own process with it.

What the launcher has started stays small and alive as a supervisor: it has MPI, but neither PETSc nor users' code. The
first rank of each group starts the processes that solve its cases, one after the other (`groupprocess`): on one rank by
itself, on several by mpiexec. Should they crash, it notes that in the ledger and starts them again, and they go on with
other cases. A case that takes longer than its limit stops itself at the next Newton iteration; where it does not, since
it is in code that never returns, its record is written here and its process is killed.
"""

from __future__ import annotations

import contextlib
import json
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
from typing import TYPE_CHECKING, cast

from hpcinv.batch.grouptask import Ended, GroupTask, Held, Listener
from hpcinv.batch.ledger.ledger import Ledger, ledger_of
from hpcinv.errors import Interrupted, SystemPartMissing
from hpcinv.parallel.processes import Identity
from hpcinv.parallel.ranks import MPI

if TYPE_CHECKING:
    from hpcinv.batch.task import Batch
    from hpcinv.parallel.signals import StopRequest

_PAUSE = 0.05  # seconds between looks at a group
_IN_VAIN = 3  # starts in a row that end before a case is begun
_STOP = 1  # tag of the message that a signal has come to another rank of the group
_OF_LAUNCHERS = ("PMI", "HYD", "MPI_LOCAL", "OMPI_COMM_WORLD", "OMPI_MCA_orte", "OMPI_MCA_ess", "OMPI_UNIVERSE", "PRTE")

# It ends with its parent by whatever end, and may use the processors of all ranks of its group.
_LAUNCH = """
import ctypes, json, os, signal, sys
parent, processors = int(sys.argv[1]), json.loads(sys.argv[2])
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    os.sched_setaffinity(0, processors)
if os.getppid() != parent:
    sys.exit(1)
os.execvp(sys.argv[3], sys.argv[3:])
"""


def can_isolate(group: MPI.Intracomm) -> bool:
    """Whether the ranks of a group can be started again: one can, several on one machine by mpiexec. Collective."""
    if group.size == 1:
        return True
    identity = Identity.of_this_process()
    machines = set(group.allgather(identity.machine or identity.host))
    return len(machines) == 1 and bool(group.bcast(_mpiexec()))


def supervise(
    batch: Batch,
    group: MPI.Intracomm,
    begin: float,
    lease: float,
    note: Callable[[str], None],
    stop: StopRequest,
) -> None:
    """Let the cases of a batch that are open be solved by processes of their own; collective.

    Args:
        begin: where in the list of all cases, from 0 to 1.
        lease: seconds in which a holder on another machine must give a sign of life.
        note: called on the first rank.

    Raises:
        Interrupted: on every rank of the group: a signal came, and cases are left.
        OutputError, SystemPartMissing: on the first rank: the store cannot be used, or no process can be started.
    """
    processors = sorted(set().union(*group.allgather(_processors())))
    if group.rank != 0:
        _wait_for_first(group, stop)
        return
    try:
        _Supervisor(GroupTask(batch, begin, lease), group, processors, note, stop).run()
    finally:
        group.Ibarrier().Wait()
        while group.Iprobe(tag=_STOP):
            group.recv(tag=_STOP)


def _wait_for_first(group: MPI.Intracomm, stop: StopRequest) -> None:
    everyone, told = group.Ibarrier(), list[MPI.Request]()
    while not everyone.Test():
        if stop.signal is not None and not told:
            told.append(group.isend(int(stop.signal), 0, tag=_STOP))
        time.sleep(_PAUSE)
    MPI.Request.Waitall(told)


@dataclass
class _Outcome:
    """How the processes of a group ended: by themselves, or with a case in hand; ``code`` as subprocess has it."""

    ended: Ended | None
    held: Held | None
    code: int
    begun: bool  # whether they have begun a case


class _Supervisor:
    """On the first rank of a group."""

    def __init__(
        self,
        task: GroupTask,
        group: MPI.Intracomm,
        processors: Sequence[int],
        note: Callable[[str], None],
        stop: StopRequest,
    ) -> None:
        self.task, self.group, self.processors, self.note, self.stop = task, group, processors, note, stop
        self.ledger: Ledger = ledger_of(task.batch.store)

    def run(self) -> None:
        in_vain = 0
        while True:
            with tempfile.TemporaryDirectory(prefix="hpcinv-") as place:
                outcome = self._attend(Path(place))
            if outcome.ended is not None:
                if outcome.ended.error is not None:
                    raise outcome.ended.error
                return
            if self._asked_to_stop() is not None:
                if outcome.held is not None:
                    self.ledger.release(outcome.held.claim)
                raise Interrupted("stopped by a signal")
            if outcome.held is not None:
                self._note_crash(outcome.held, outcome.code)
            in_vain = 0 if outcome.begun else in_vain + 1
            if in_vain == _IN_VAIN:
                raise SystemPartMissing(
                    f"the processes that solve cases have {_how(outcome.code)}, {_IN_VAIN} times before they began one",
                    "See what they printed. With --no-isolation the ranks of the launcher solve cases themselves.",
                )

    def _attend(self, place: Path) -> _Outcome:
        """Start the processes of the group, and watch them until their end."""
        self.task.write(place)
        listener = Listener(place)
        process = self._start(place)
        outcome = _Outcome(None, None, 0, begun=False)
        since, signalled = time.monotonic(), False
        try:
            while True:
                over = _wait(process)  # before its last words are read
                for event in listener.events():
                    if isinstance(event, Ended):
                        outcome.ended = event
                    else:
                        outcome.held, since = event, time.monotonic()
                        outcome.begun = True
                if over:
                    outcome.code = process.returncode
                    return outcome
                if not signalled and (asked := self._asked_to_stop()) is not None:
                    signalled = True
                    process.send_signal(asked)
                if outcome.held is not None and self._is_stuck(time.monotonic() - since):
                    self._give_up(outcome.held)
                    outcome.held = None
                    return outcome
        finally:
            _kill(process)
            listener.close()

    def _start(self, place: Path) -> subprocess.Popen[bytes]:
        program = [sys.executable, "-m", "hpcinv.batch.groupprocess", str(place)]
        if self.group.size > 1:
            program = [cast(str, _mpiexec()), "-n", str(self.group.size), *program]
        first = [sys.executable, "-I", "-S", "-c", _LAUNCH, str(os.getpid()), json.dumps(list(self.processors))]
        return subprocess.Popen(
            [*first, *program], env=_environment(), stdin=subprocess.DEVNULL, start_new_session=True
        )

    def _asked_to_stop(self) -> signal.Signals | None:
        """The signal that has come to a rank of the group."""
        if self.stop.signal is None and self.group.Iprobe(tag=_STOP):
            self.stop.signal = signal.Signals(self.group.recv(tag=_STOP))
        return self.stop.signal

    def _is_stuck(self, seconds: float) -> bool:
        """Whether a case has had its limit, and the time to notice that by itself."""
        limit = self.task.batch.limit
        return limit is not None and seconds > limit + max(5.0, 0.1 * limit)

    def _give_up(self, held: Held) -> None:
        """Record that a case took too long, while its process still has the claim, so that no other takes it over."""
        record = self.task.batch.overdue_record(held.claim)
        if self.ledger.commit(held.claim, record):
            self.note(f"{held.title}: {record.status}, and did not stop: its process is ended")

    def _note_crash(self, held: Held, code: int) -> None:
        """Note how a case has ended its process."""
        how = _how(code)
        self.ledger.crashed(held.claim, how)
        self.note(f"{held.title}: crashed its process ({how}); the others go on in a new one")


def _how(code: int) -> str:
    """How processes ended. mpiexec gives the number of a signal as its exit code."""
    fatal = (signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGKILL)
    if code < 0 or code in fatal:
        with contextlib.suppress(ValueError):
            return f"ended by {signal.Signals(abs(code)).name}"
    return f"ended with exit code {code} before all was done"


def _wait(process: subprocess.Popen[bytes]) -> bool:
    """Whether a process has ended, after a moment."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(_PAUSE)
    return process.returncode is not None


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End what is left of a group's processes, which have a session of their own."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _mpiexec() -> str | None:
    """The one that belongs to this Python's MPI is beside it."""
    return shutil.which("mpiexec", path=str(Path(sys.executable).parent)) or shutil.which("mpiexec")


def _processors() -> list[int]:
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []


def _environment() -> dict[str, str]:
    """Without what a launcher tells its ranks, so that MPI begins anew; a nested mpiexec starts processes here."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(_OF_LAUNCHERS)}
    return kept | {"HYDRA_LAUNCHER": "fork", "HYDRA_RMK": "user"}
