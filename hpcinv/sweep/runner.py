"""Runner of the cases of a sweep: reuses mesh, equations and solutions of earlier cases, and resumes them."""

import contextlib
import shutil
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from hpcinv.batch.ledger.case_record import CaseRecord
from hpcinv.batch.ledger.store import as_output_error
from hpcinv.batch.task import Runner
from hpcinv.certificate import Verdict
from hpcinv.driver import run
from hpcinv.errors import CheckpointError
from hpcinv.files.inputs import changed_inputs
from hpcinv.methods.method import Guess
from hpcinv.output.progress import SilentProgress
from hpcinv.output.result import Result
from hpcinv.parallel.runtime import MPI, on_root
from hpcinv.solver.workspace import Workspace
from hpcinv.sweep.neighbours import Neighbour, Neighbours
from hpcinv.sweep.queue import SweepTask

_KEPT = (
    "shape.*",
    "shape-*",
    "fields",
    "surface.npz",
    "interior.npz",
    "snapshots",
    "report.html",
)  # patterns in a run's directory; the summary is in the record


class SweepRunner(Runner[SweepTask]):
    """Solves cases on all ranks of ``comm``.

    Args:
        warm_start: whether the initial guess of a case is extrapolated from the solutions of its neighbours.
    """

    collect_every = 20

    def __init__(self, comm: MPI.Intracomm, *, warm_start: bool) -> None:
        self.comm, self.warm_start = comm, warm_start
        self.workspace = Workspace(comm)
        self.neighbours: tuple[str, Neighbours] = "", Neighbours()

    def clear(self) -> None:
        self.workspace.clear()

    def run(self, task: SweepTask, progress: SilentProgress, stop_asked: Callable[[], bool]) -> dict[str, Any]:
        known = on_root(self.comm, task.directory.summary)
        if (
            known is not None
            and known["status"] == "converged"
            and not on_root(self.comm, lambda: _has_changed(task, known))
        ):
            progress.statistics = known  # an earlier attempt was killed just before its commit
            return {}
        start, guess = self._guess(task)
        self._remember(task, self._run(task, progress, guess, stop_asked))
        return {"start": start if _began_with_guess(progress.statistics) else ""}

    def _run(
        self, task: SweepTask, progress: SilentProgress, guess: Guess | None, stop_asked: Callable[[], bool]
    ) -> Result:
        """Run from the last checkpoint if there is a valid one, else from the beginning."""
        go = partial(
            run,
            task.job,
            self.comm,
            directory=task.directory,
            progress=progress,
            stop_asked=stop_asked,
            workspace=self.workspace,
            guesses=() if guess is None else (guess,),
        )
        if on_root(self.comm, lambda: task.directory.is_begun):
            with contextlib.suppress(CheckpointError):
                return go(resume=True)
        on_root(self.comm, partial(_clear, task.directory.path))
        return go()

    def _guess(self, task: SweepTask) -> tuple[str, Guess | None]:
        group, known = self.neighbours
        guess = known.guess(task.point) if group == task.reuse_group else None
        return ("", None) if guess is None else (guess[1], guess[0])

    def _remember(self, task: SweepTask, result: Result) -> None:
        """Keep the solution for later cases, unless it lies beyond a limit point or its certificate fails."""
        solution = result.solutions[0]
        signs = {sign for solve in solution.solves if solve.outcome.accepted for sign in solve.signs}
        doubtful = len(signs) > 1 or result.certificate.verdict is Verdict.FAIL
        if not self.warm_start or result.accuracy is not None or doubtful:
            return
        if self.neighbours[0] != task.reuse_group:
            self.neighbours = task.reuse_group, Neighbours()
        neighbour = Neighbour(task.claim.key, task.point, solution.as_guess())
        self.neighbours[1].add(neighbour, self.comm.allreduce(neighbour.bytes, op=MPI.MAX))

    def remove_run(self, task: SweepTask, record: CaseRecord) -> None:
        directory = task.directory
        if record.converged and any(path for kept in _KEPT for path in directory.path.glob(kept)):
            shutil.rmtree(directory.checkpoints, ignore_errors=True)
        else:
            super().remove_run(task, record)


def _has_changed(task: SweepTask, summary: Mapping[str, Any]) -> bool:
    """Return whether the mesh of a finished run was made from files that have changed since."""
    home = task.job.resolve(task.job.mesh.file).absolute().parent
    return bool(changed_inputs(summary["mesh"].get("inputs", {}), home))


def _clear(path: Path) -> None:
    """Remove files of earlier attempts from which no run can resume."""
    with as_output_error(path):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _began_with_guess(statistics: Mapping[str, Any]) -> bool:
    solves = statistics["solutions"][0]["solves"] if statistics else []
    return bool(solves) and all(solve["strategy"] == "guess" for solve in solves)
