"""A group of ranks that solves one case after the other, as long as there are any."""

from __future__ import annotations

import contextlib
import json
import shutil
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from hpcinv.batch.ledger.ledger import CRASHES, DEADLY, KILLED, LOST
from hpcinv.batch.ledger.record import Record
from hpcinv.batch.ledger.store import told
from hpcinv.certificate import Verdict
from hpcinv.driver import run
from hpcinv.errors import CheckpointError, HpcinvError, Interrupted, JobError, MeshError, SolveError
from hpcinv.methods.initial_guess import Guess
from hpcinv.output.progress import Listener
from hpcinv.output.run_directory import RunDirectory
from hpcinv.parallel.runtime import MPI, on_root
from hpcinv.solver.problem_cache import Workspace, collect_garbage
from hpcinv.sweep.neighbours import Neighbours, Solution
from hpcinv.sweep.outcomes import overdue_record, remove_run

if TYPE_CHECKING:
    from hpcinv.batch.ledger.ledger import Claim
    from hpcinv.job.job import Job
    from hpcinv.output.result import Result
    from hpcinv.sweep.neighbours import Floats
    from hpcinv.sweep.plan import Case, Plan
    from hpcinv.sweep.queue import Queue

_KEPT = ("shape.*", "fields")  # of a run's directory; the summary is in the record
_COLLECT = 20  # cases between collections of garbage


@dataclass(frozen=True)
class Task:
    """A case that this group has claimed; the claim is known to its first rank."""

    case: Case
    job: Job
    claim: Claim
    point: Floats
    directory: RunDirectory


class Worker:
    """Runs cases on all ranks of ``comm``.

    Args:
        queue: on rank 0, ``None`` on the others.
        note: told on rank 0 of each case that has ended.
        stop_asked: asked on every rank.
        holding: told on rank 0 of each case that is begun, and by ``None`` that it is over.
    """

    def __init__(
        self,
        plan: Plan,
        comm: MPI.Intracomm,
        queue: Queue | None,
        note: Callable[[str], None],
        stop_asked: Callable[[], bool],
        holding: Callable[[Claim | None], None] = lambda claim: None,
    ) -> None:
        self.plan, self.comm, self.queue = plan, comm, queue
        self.note, self.stop_asked, self.holding = note, stop_asked, holding
        self.workspace = Workspace(comm)
        self.neighbours: tuple[str, Neighbours] = "", Neighbours()
        self.solved = 0

    def work(self) -> None:
        """Solve cases until none is left that others do not have in hand; collective.

        Raises:
            Interrupted: a signal asked to stop; the case at hand is given back, with what it has saved.
            OutputError, SystemPartMissing: the same on every rank; the case is given back.
        """
        with self.workspace:
            while True:
                if self.comm.allreduce(self.stop_asked(), op=MPI.LOR):
                    raise Interrupted("stopped by a signal")
                task = on_root(self.comm, self._next)
                if task is None:
                    return
                try:
                    record = self._solve(task)
                except HpcinvError:
                    if on_root(self.comm, partial(self._release, task)):
                        raise
                else:
                    on_root(self.comm, partial(self._commit, task, record))
                self.solved += 1
                if self.solved % _COLLECT == 0:
                    collect_garbage(self.comm)

    def _next(self) -> Task | None:
        assert self.queue is not None
        if (found := self.queue.next()) is None:
            return None
        case, claim = found
        text = yaml.safe_dump(_plain(self.plan.content(case)), sort_keys=False, allow_unicode=True)
        self.holding(claim)
        directory = RunDirectory(claim.run, text, claimed=True)
        return Task(case, self.plan.job(case), claim, self.queue.point(case), directory)

    def _solve(self, task: Task) -> Record:
        """Solve a case; that it cannot be solved is a result too."""
        begun = time.perf_counter()
        record = Record("", "", {}, 0.0, task.claim.attempt)
        crashes = [how for how in task.claim.crashes if how != KILLED]
        if len(crashes) >= CRASHES:
            status = f"its process crashed {len(crashes)} times: {crashes[-1]}"
            return replace(record, status=status, advice="What it printed last is in the output of the sweep.")
        if task.claim.died >= DEADLY or task.claim.lost >= LOST:
            status = f"the process that ran it was killed {task.claim.died + task.claim.lost} times"
            return replace(
                record,
                status=status,
                advice="Was it, or a case beside it, out of memory? Give it more, or a coarser mesh.",
            )
        if (known := on_root(self.comm, lambda: _summary(task.directory))) is not None:
            return replace(record, status="converged", statistics=known)  # it was killed just before its commit
        heard = Listener(self.comm)
        start, guess = self._guess(task)
        overdue = self._overdue(begun)
        try:
            result = self._run(task, heard, guess, lambda: self.stop_asked() or overdue())
            self._remember(task, result)
            record = replace(record, status="converged")
        except (SolveError, MeshError) as error:
            record = replace(record, status=error.message, advice=error.advice)
        except JobError as error:  # a formula without a value
            record = replace(record, status="; ".join(error.problems))
        except Interrupted:
            if self.comm.allreduce(self.stop_asked(), op=MPI.LOR) or not self.comm.allreduce(overdue(), op=MPI.LOR):
                raise
            record = overdue_record(self.plan.sweep.limit, task.claim)
        except HpcinvError:
            raise
        except Exception as error:
            if self.comm.size > 1:  # the ranks may have lost each other
                raise
            record = replace(record, status=_unforeseen(error), advice="This is an error in hpcinv; please report it.")
            self.workspace.clear()
        seconds = time.perf_counter() - begun
        if start and not _began_with_guess(heard.statistics):
            start = ""
        return replace(record, statistics=heard.statistics, seconds=seconds, start=start)

    def _overdue(self, begun: float) -> Callable[[], bool]:
        """Whether a case takes longer than its limit."""
        limit = self.plan.sweep.limit
        return lambda: limit is not None and time.perf_counter() - begun > limit

    def _run(self, task: Task, heard: Listener, guess: Guess | None, stop_asked: Callable[[], bool]) -> Result:
        """From the last checkpoint if there is one that can be used."""
        go = partial(
            run,
            task.job,
            self.comm,
            directory=task.directory,
            progress=heard,
            stop_asked=stop_asked,
            workspace=self.workspace,
            guess=guess,
        )
        if on_root(self.comm, lambda: task.directory.is_begun):
            with contextlib.suppress(CheckpointError):
                return go(resume=True)
        on_root(self.comm, partial(_clear, task.directory.path))
        return go()

    def _guess(self, task: Task) -> tuple[str, Guess | None]:
        """Key of the nearest case, and what to begin with."""
        structure, known = self.neighbours
        if not self.plan.sweep.warm_start or structure != task.case.structure:
            return "", None
        found = known.guess(task.point)
        return ("", None) if found is None else (found[1], found[0])

    def _remember(self, task: Task, result: Result) -> None:
        """Keep the solution for the cases to come, unless it lies beyond a fold or is not to be trusted."""
        leg = result.legs[0]
        signs = {sign for solve in leg.solves if solve.outcome.accepted for sign in solve.signs}
        doubtful = len(signs) > 1 or result.certificate.verdict is Verdict.FAIL
        if not self.plan.sweep.warm_start or result.accuracy is not None or doubtful:
            return
        if self.neighbours[0] != task.case.structure:
            self.neighbours = task.case.structure, Neighbours()
        pressure = None if leg.pressure is None else leg.pressure.x.array.copy()
        guess = Guess(leg.displacement.x.array.copy(), pressure, signs.pop() if signs else 0)
        solution = Solution(task.case.key, task.point, guess)
        self.neighbours[1].add(solution, self.comm.allreduce(solution.bytes, op=MPI.MAX))

    def _release(self, task: Task) -> bool:
        """Give a case back; false if another has taken it over, and its directory with it, which explains the error."""
        assert self.queue is not None
        if not self.queue.ledger.holds(task.claim):
            self.note(f"{task.case.title}: was taken over by another, who thought that this process had ended")
            self.holding(None)
            return False
        self.queue.ledger.release(task.claim)
        self.holding(None)
        return True

    def _commit(self, task: Task, record: Record) -> None:
        assert self.queue is not None
        first = self.queue.ledger.commit(task.claim, record)
        if record.converged and any(path for kept in _KEPT for path in task.directory.path.glob(kept)):
            shutil.rmtree(task.directory.checkpoints, ignore_errors=True)
        else:
            remove_run(task.claim)
        self.holding(None)
        self.note(_line(task.case, record, first=first))


def _clear(path: Path) -> None:
    """Remove what earlier attempts have left that no run can go on from."""
    with told(path):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _summary(directory: RunDirectory) -> Mapping[str, Any] | None:
    """The summary of a run that was finished, but not committed."""
    if not directory.is_finished:
        return None
    found: Mapping[str, Any] = json.loads((directory.path / "summary.json").read_text(encoding="utf-8"))
    return found


def _began_with_guess(statistics: Mapping[str, Any]) -> bool:
    solves = statistics["legs"][0]["solves"] if statistics else []
    return bool(solves) and all(solve["strategy"] == "guess" for solve in solves)


def _unforeseen(error: Exception) -> str:
    where = traceback.extract_tb(error.__traceback__)[-1]
    return f"internal error: {type(error).__name__}: {error} ({where.name}, line {where.lineno})"


def _line(case: Case, record: Record, *, first: bool) -> str:
    line = f"{case.title}: "
    if not first:
        return line + "was done by another meanwhile"
    if not record.converged:
        return line + record.status
    certificate = record.statistics["certificate"]["verdict"]
    line += f"{record.seconds:.2f} s, certificate {certificate}" + (", from a guess" if record.start else "")
    warnings = (record.statistics.get("body") or {"warnings": []})["warnings"]
    return "; ".join([line, *(f"warning: {text}" for text in warnings)])


def _plain(value: Any) -> Any:
    """As YAML has it."""
    if isinstance(value, Mapping):
        return {key: _plain(v) for key, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value
