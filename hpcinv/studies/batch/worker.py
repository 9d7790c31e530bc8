"""Worker of a group of ranks: claims and solves one case after the other until none is left."""

import time
import traceback
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import HpcinvError, Interrupted, JobError, MeshError, OutputError, SolveError, described
from hpcinv.output.progress import SilentProgress
from hpcinv.physics.points.interpreter import note_on_speed
from hpcinv.solver.workspace import collect_garbage
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.claims import CRASHES, DEADLY, KILLED, LOST, Claim
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger
from hpcinv.studies.batch.task import Batch, BatchTask, Pause, Schedule

_PAUSE = 1.0  # seconds between checks of cases that other groups hold


def work(
    batch: Batch,
    group: MPI.Intracomm,
    begin: float,
    lease: float,
    note: Callable[[str], None],
    stop_asked: Callable[[], bool],
    holding: Callable[[BatchTask | None], None] | None = None,
) -> None:
    """Solve the open cases; collective.

    Args:
        begin: share of the list of cases at which the group begins, from 0 to 1.
        lease: seconds within which the heartbeat of a holder on another machine must change.
        note: called on the first rank with a line on each finished case, and before them on a missing compiler.
        stop_asked: called on every rank; true ends the work.
        holding: called on the first rank with each case when it begins, and with ``None`` when it has ended; given only
            where a supervisor notes crashes.

    Raises:
        HpcinvError: the same on every rank, from `Worker.work`.
    """
    with ExitStack() as held:
        worker = Worker(batch, group, note, stop_asked, holding or (lambda task: None))

        def open_ledger() -> None:
            holder = held.enter_context(Holder(batch.store))
            worker.ledger = Ledger(batch.store, holder, lease=lease, supervised=holding is not None)
            held.callback(_close, worker.ledger)
            worker.schedule = batch.schedule(worker.ledger, begin, group.size)

        on_root(group, open_ledger)
        if group.rank == 0 and begin == 0 and (slow := note_on_speed()):  # other groups begin elsewhere
            note(slow)
        worker.work()


@dataclass
class Worker:
    """Solves cases on all ranks of ``comm``; ledger and schedule are on the first one."""

    batch: Batch
    comm: MPI.Intracomm
    note: Callable[[str], None]
    stop_asked: Callable[[], bool]
    holding: Callable[[BatchTask | None], None]

    def __post_init__(self) -> None:
        self.ledger: Ledger
        self.schedule: Schedule[Any]
        self.runner = self.batch.runner(self.comm)
        self.solved = 0

    def work(self) -> None:
        """Solve cases until none is left that other groups do not hold; collective.

        Raises:
            Interrupted: a signal was received; the present case is released, and its checkpoints are kept.
            OutputError, SystemPartMissing: the same on every rank; the case is released.
        """
        with self.runner:
            while True:
                if self.comm.allreduce(self.stop_asked(), op=MPI.LOR):
                    raise Interrupted("stopped by a signal")
                task = on_root(self.comm, self._next)
                if task is None:
                    return
                if task is Pause.WAIT:
                    time.sleep(_PAUSE)
                else:
                    self._take(task)

    def _next(self) -> BatchTask | Pause | None:
        task: BatchTask | Pause | None = self.schedule.next()
        if task is not None and task is not Pause.WAIT:
            self.holding(task)
        return task

    def _take(self, task: BatchTask) -> None:
        try:
            record = self._solve(task)
        except HpcinvError:
            if on_root(self.comm, partial(self._release, task)):
                raise
        else:
            on_root(self.comm, partial(self._commit, task, record))
        self.solved += 1
        if self.solved % self.runner.collect_every == 0:
            collect_garbage(self.comm)

    def _solve(self, task: BatchTask) -> CaseRecord:
        begun = time.perf_counter()
        record = CaseRecord("", "", {}, 0.0, task.claim.attempt)
        if (given_up := _given_up(task.claim)) is not None:
            status, advice = given_up
            return replace(record, status=status, advice=advice)
        progress = SilentProgress(self.comm)
        limit = self.batch.limit

        def overdue() -> bool:
            return limit is not None and time.perf_counter() - begun > limit

        try:
            entries = self.runner.run(task, progress, lambda: self.stop_asked() or overdue())
            record = replace(record, status="converged", **entries)
        except (SolveError, MeshError) as error:
            record = replace(record, status=error.message, advice=error.advice)
        except JobError as error:  # for example a formula without a value
            record = replace(record, status="; ".join(error.problems))
        except Interrupted:
            if self.comm.allreduce(self.stop_asked(), op=MPI.LOR) or not self.comm.allreduce(overdue(), op=MPI.LOR):
                raise
            record = self.batch.overdue_record(task.claim)
        except Exception as error:
            # Several ranks may not be at the same collective call any more.
            if isinstance(error, HpcinvError) or self.comm.size > 1:
                raise
            record = replace(record, status=_unforeseen(error), advice="This is an error in hpcinv; please report it.")
            self.runner.clear()
        return replace(record, statistics=progress.statistics, seconds=time.perf_counter() - begun)

    def _release(self, task: BatchTask) -> bool:
        """Release a case; ``False`` if another process has claimed it and its directory, which explains the error."""
        if not self.ledger.holds(task.claim):
            self.note(f"{task.title}: was claimed by another process, since this one seemed to have ended")
            self.holding(None)
            return False
        self.ledger.release(task.claim)
        self.holding(None)
        return True

    def _commit(self, task: BatchTask, record: CaseRecord) -> None:
        first = self.ledger.commit(task.claim, record)
        self.runner.remove_run(task, record)
        self.holding(None)
        meanwhile = f"{task.title}: was finished by another process meanwhile"
        self.note(self.schedule.report(task, record) if first else meanwhile)


def _close(ledger: Ledger) -> None:
    with suppress(OutputError):  # other processes will find that this one has ended
        ledger.close()


def _given_up(claim: Claim) -> tuple[str, str] | None:
    """Return status and advice of a case that has crashed or killed too many processes to be tried again."""
    crashes = [how for how in claim.crashes if how != KILLED]
    if len(crashes) >= CRASHES:
        status = f"its process crashed {len(crashes)} times: {crashes[-1]}"
        return status, "See what it printed last."
    if claim.died >= DEADLY or claim.lost >= LOST:
        status = f"the process that ran it was killed {claim.died + claim.lost} times"
        return (
            status,
            "It or another case may have run out of memory: use more memory or a coarser mesh.",
        )
    return None


def _unforeseen(error: Exception) -> str:
    where = traceback.extract_tb(error.__traceback__)[-1]
    return f"internal error: {described(error)} ({where.name}, line {where.lineno})"
