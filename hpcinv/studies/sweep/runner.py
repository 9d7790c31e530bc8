"""Runner of the cases of a sweep: reuses mesh, equations and solutions of earlier cases, and resumes them."""

import contextlib
import shutil
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from hpcinv.base.files.inputs import changed_inputs
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.parallel.timings import Timings
from hpcinv.driver import run
from hpcinv.errors import CheckpointError, MeshError
from hpcinv.job.job import UNNAMED, parse
from hpcinv.output.progress import SilentProgress
from hpcinv.output.result import Result
from hpcinv.physics.points.scalar_graph import NotAnalytic
from hpcinv.results.solution import Solution
from hpcinv.solver.methods.method import GUESS, Guess
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.store import as_output_error
from hpcinv.studies.batch.task import Runner
from hpcinv.studies.sweep.neighbours import MOST_BYTES, Neighbour, Neighbours
from hpcinv.studies.sweep.parameter_series import STRATEGY, ParameterSeries, expanded
from hpcinv.studies.sweep.queue import Ahead, SweepTask
from hpcinv.trust.certificate import Verdict

_KEPT = (
    "shape.*",
    "shape-*",
    "fields",
    "surface.npz",
    "interior.npz",
    "snapshots",
    "report.html",
)  # patterns in a run's directory; the summary is in the record

EXPANSION = 5
"""Cases whose factorizations take as long as an expansion. Raised, short axes are solved case by case."""
SET_UP = 12_500
"""Cases times unknowns whose factorizations take as long as the set-up of a series (0.3 s). Raised, small bodies are
solved case by case."""


class SweepRunner(Runner[SweepTask]):
    """Solves cases on all ranks of ``comm``.

    Args:
        warm_start: whether the initial guess of a case is extrapolated from the solutions of its neighbours.
        keeps_solutions: whether the last checkpoint of each converged case is kept.
    """

    collect_every = 20

    def __init__(self, comm: MPI.Intracomm, *, warm_start: bool, keeps_solutions: bool = False) -> None:
        self.comm, self.warm_start, self.keeps_solutions = comm, warm_start, keeps_solutions
        self.workspace = Workspace(comm)
        self.neighbours: tuple[str, list[Neighbours]] = "", []
        """reuse group, and the solutions of each solve of its plan"""
        self.series: tuple[str, list[ParameterSeries]] = "", []
        self.without_series = ""
        """reuse group without a series, the last one found"""

    def clear(self) -> None:
        self.workspace.clear()
        self.series = "", []

    def run(self, task: SweepTask, progress: SilentProgress, stop_asked: Callable[[], bool]) -> dict[str, Any]:
        known = on_root(self.comm, task.directory.summary)
        if (
            known is not None
            and known["status"] == "converged"
            and not on_root(self.comm, lambda: _has_changed(task, known))
        ):
            progress.statistics = known  # an earlier attempt was killed just before its commit
            return {}
        start, guesses = self._guesses(task)
        result = self._run(task, progress, guesses, stop_asked)
        strategy = _start_strategy(progress.statistics)
        entries = {"start": start if strategy else "", "by_series": strategy == STRATEGY}
        is_kept = self._remember(task, result)
        # Without new factors, the present series still serves.
        is_new = result.solutions[0].factorizations > 0 and self.without_series != task.reuse_group
        if is_kept and is_new and task.ahead is not None and _is_worth(result.solutions[0], task.ahead):
            entries["remark"] = self._expand(task, task.ahead, result.solutions[0])
        return entries

    def _run(
        self, task: SweepTask, progress: SilentProgress, guesses: Sequence[Guess], stop_asked: Callable[[], bool]
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
            guesses=guesses,
        )
        if on_root(self.comm, lambda: task.directory.is_begun):
            with contextlib.suppress(CheckpointError):
                return go(resume=True)
        on_root(self.comm, partial(_clear, task.directory.path))
        return go()

    def _guesses(self, task: SweepTask) -> tuple[str, list[Guess]]:
        """Return the starts of a case's solves, and the key of the case whose solution or series is the first one.

        Collective.
        """
        group, known = self.neighbours
        starts = [start for solve in known if (start := solve.guess(task.point))] if group == task.reuse_group else []
        key, guesses = starts[0][1] if starts else "", [guess for guess, _ in starts]
        group, series = self.series
        if group == task.reuse_group:
            values = [(one.key, value) for one in series if (value := one.guess(task.numbers)) is not None]
            if values:
                key, (guess, _) = min(values, key=lambda entry: entry[1][1])
                return key, [guess, *guesses[1:]]
        return key, guesses

    def _remember(self, task: SweepTask, result: Result) -> bool:
        """Keep the solutions for later cases, unless one lies beyond a limit point or their certificate fails.

        Return whether they are kept.
        """
        signs = [{sign for s in one.solves if s.outcome.accepted for sign in s.signs} for one in result.solutions]
        doubtful = any(len(own) > 1 for own in signs) or result.certificate.verdict is Verdict.FAIL
        if not self.warm_start or result.accuracy is not None or doubtful:
            return False
        if self.neighbours[0] != task.reuse_group:
            self.neighbours = task.reuse_group, [Neighbours() for _ in result.solutions]
        for known, solution in zip(self.neighbours[1], result.solutions, strict=True):
            neighbour = Neighbour(task.claim.key, task.point, solution.as_guess())
            largest = self.comm.allreduce(neighbour.bytes, op=MPI.MAX)
            known.add(neighbour, largest * len(result.solutions))
        return True

    def _expand(self, task: SweepTask, ahead: Ahead, solution: Solution) -> str:
        """Make a power series at a solution, to the cases ahead on its line; return the remark on it; collective."""
        path, untrusted = task.job.path or Path(UNNAMED), task.job.is_untrusted
        job = on_root(self.comm, lambda: parse(ahead.content, path, untrusted=untrusted))
        try:
            equations = self.workspace.equations(job, self.workspace.body(job), Timings())[0]
            series = expanded(equations, solution, task.claim.key, task.numbers, ahead.numbers)
        except (NotAnalytic, MeshError) as reason:
            self.without_series = task.reuse_group
            return f"no power series: {reason.message if isinstance(reason, MeshError) else reason}"
        group, kept = self.series
        kept = [*(kept if group == task.reuse_group else []), series]
        while len(kept) > 1 and self.comm.allreduce(sum(one.bytes for one in kept), op=MPI.MAX) > MOST_BYTES:
            kept.pop(0)
        self.series = task.reuse_group, kept
        return "power series for the cases on its line"

    def remove_run(self, task: SweepTask, record: CaseRecord) -> None:
        directory = task.directory
        if record.converged and self.keeps_solutions:
            return
        if record.converged and any(path for kept in _KEPT for path in directory.path.glob(kept)):
            shutil.rmtree(directory.checkpoints, ignore_errors=True)
        else:
            super().remove_run(task, record)


def _is_worth(solution: Solution, ahead: Ahead) -> bool:
    """Return whether a power series takes less time than the factorizations that it saves."""
    fields = (field for field in solution.fields if field is not None)
    spaces = [field.function_space.dofmap for field in fields]
    unknowns = sum(space.index_map.size_global * space.index_map_bs for space in spaces)
    return bool((ahead.count - EXPANSION) * unknowns >= SET_UP)


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


def _start_strategy(statistics: Mapping[str, Any]) -> str:
    """Return the strategy of the guess from which a case was solved; empty if it was not solved from one."""
    solves = statistics["solutions"][0]["solves"] if statistics else []
    strategies = {solve["strategy"] for solve in solves}
    return str(strategies.pop()) if strategies in ({GUESS}, {STRATEGY}) else ""
