"""The flow of a run: prepare (job → body → equations), solve, check, write."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from weakref import ref

from hpcinv.base.files.untrusted import applied_to
from hpcinv.base.parallel.left_for_run import require_communicators
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.signals import ended_late, signals_recorded
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.job import Job, PlannedSolve
from hpcinv.job.quantity_of_interest import QuantityValue
from hpcinv.job.state_differences import with_differences
from hpcinv.on_demand import on_demand
from hpcinv.output.checkpoint_writer import CheckpointWriter
from hpcinv.output.progress import Progress
from hpcinv.output.result import Result
from hpcinv.output.run_directory import RunDirectory
from hpcinv.output.run_report import RunReport
from hpcinv.output.run_store import RunStore
from hpcinv.output.snapshot_writer import SnapshotWriter
from hpcinv.physics.points.ffcx_fallback import notes_on_ffcx
from hpcinv.physics.points.interpreter import note_on_speed
from hpcinv.preparation import Prepared, prepare
from hpcinv.results.quantities_of_interest import carried, evaluate
from hpcinv.results.shape_distance import differences
from hpcinv.results.solution import Solution
from hpcinv.results.steps import StepControl, carry_out
from hpcinv.results.totals import totals_of
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods.method import Guess, Start
from hpcinv.solver.observer import Observers, SolvedDirection, Stopped, StopSignal
from hpcinv.solver.workspace import Workspace
from hpcinv.trust.certificate import Certificate, Estimate, certify_all
from hpcinv.trust.sensitivity.sensitivities import (
    Sensitivities,
    Spreads,
    SurfaceSpread,
    joined_sensitivities,
    spreads_of,
)


def run(
    job: Job,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    *,
    directory: Path | RunDirectory | None = None,
    overwrite: bool = False,
    resume: bool = False,
    progress: Progress | None = None,
    stop_asked: Callable[[], bool] = lambda: False,
    workspace: Workspace | None = None,
    guesses: Sequence[Guess] = (),
    end_late: Callable[[], NoReturn] | None = None,
) -> Result:
    """Solve a job on all ranks of ``comm``; collective.

    Args:
        directory: of checkpoints and results; ``None`` writes nothing.
        overwrite: whether results of another run may be replaced.
        resume: continue from the last checkpoint in ``directory``, if there is one.
        stop_asked: called on every rank before each Newton iteration, and where else a run can stop: before it solves,
            and in the certificate if there is a directory for checkpoints; true saves a checkpoint and ends the run.
        workspace: body and equations of earlier runs on ``comm``, to be used again by this run and later ones.
        guesses: initial guesses of the first solves at full load; without one, or if it fails, the unloaded body.
        end_late: ends all ranks, if a signal asks to stop and a check of the certificate takes too long to do so.

    Raises:
        MeshError, OutputError, CheckpointError, SystemPartMissing, OutOfMemory: the same on every rank.
        SolveError: the load was not reached; the diagnosis is in the message and in ``summary.json``.
        Interrupted: ``stop_asked`` was true on some rank.
    """
    require_communicators(comm)
    with ExitStack() as own:
        workspace = workspace or own.enter_context(Workspace(comm))
        progress = progress or own.enter_context(Progress(comm, None))
        store = own.enter_context(RunStore(directory, comm))
        if job.is_untrusted:
            own.enter_context(applied_to([job.resolve("."), *([store.path] if store.path else [])]))
        stop, timings = StopSignal(stop_asked), Timings()
        if resume:
            store.lock(job)
        if slow := note_on_speed():
            progress.note(slow)
        prepared = prepare(job, workspace, progress, timings, stop)
        own.enter_context(signals_recorded())
        if not guesses and prepared.job.solver.start is not None:
            predict = on_demand("start from a sweep")
            guesses = predict(prepared.job, prepared.equations, progress.note)
        outputs = _Outputs(prepared, store, progress, stop, guesses, overwrite=overwrite, resume=resume)
        solved = own.enter_context(outputs.keeping())
        _solve(prepared, outputs, solved)
        certificate, estimate, spread = _check(prepared, outputs, solved, end_late)
        result = outputs.report.conclude(
            Result(
                prepared.job,
                prepared.body,
                tuple(solved.solutions),
                certificate,
                solved.quantities,
                differences(prepared.body, solved.solutions, prepared.expected),
                estimate,
                joined_sensitivities(solved.slopes, prepared.job.quantities),
                spread,
                equations=ref(prepared.equations[0]),
            )
        )
        return outputs.report.with_second_opinion(result) if job.second_opinion else result


@dataclass
class _Solved:
    """Solutions of a run so far, with their quantities and derivatives.

    Attributes:
        values: of what was evaluated in each state; ``quantities`` are made of them.
        slopes: by the computed shape.
    """

    spreads: Spreads
    solutions: list[Solution] = field(default_factory=list)
    values: dict[str, QuantityValue] = field(default_factory=dict)
    quantities: dict[str, QuantityValue] = field(default_factory=dict)
    slopes: dict[str, Sensitivities] = field(default_factory=dict)


class _Outputs(StepControl):
    """Outputs of a run that follow its solves: messages, checkpoints, snapshots and the report."""

    def __init__(
        self,
        prepared: Prepared,
        store: RunStore,
        progress: Progress,
        stop: StopSignal,
        guesses: Sequence[Guess],
        *,
        overwrite: bool,
        resume: bool,
    ) -> None:
        job, first = prepared.job, prepared.equations[0]
        self.job, self.store, self.progress, self.stop, self.guesses = job, store, progress, stop, guesses
        checkpoints, self.restart = store.open(job, first, progress, overwrite=overwrite, resume=resume)
        with progress.phase("programs"):
            totals = totals_of(first, job.plan[0])
        progress.body(totals)
        for line in notes_on_ffcx():
            progress.note(f"  {line}")
        self.report = RunReport(job, first, store, progress, totals, prepared.record, prepared.unused_options)
        self.checkpoints = CheckpointWriter(checkpoints, store, first, progress.warn, self.restart)
        self.snapshots = SnapshotWriter(store, first, self.restart)
        super().__init__(Observers(progress, self.checkpoints, self.snapshots, self.report, stop))
        self._spreads = spreads_of(job, prepared.body)

    @contextmanager
    def keeping(self) -> Iterator[_Solved]:
        """Context of what is solved; an error leaves a summary of it."""
        solved = _Solved(self._spreads)
        with self.report.keeping(solved.solutions, solved.quantities):
            yield solved

    def choose_start(self, number: int, equations: Equations) -> Start:
        start = self.restart and self.restart.start(number, equations, self.job.plan[number].direction)
        self.progress.state(self.job, number)
        self.snapshots.begin(number, equations, self.job.plan[number].direction)
        return start or Start(guess=self.guesses[number] if number < len(self.guesses) else None)

    def solving(self) -> AbstractContextManager[None]:
        return self.progress.phase("solving", announced=False)

    def note(self, text: str) -> None:
        self.progress.note(text)

    def check(self, earlier: Sequence[Solution], solved: SolvedDirection, step: PlannedSolve) -> None:
        self.report.check_not_stopped(earlier, solved, step.job.state)


def _solve(prepared: Prepared, outputs: _Outputs, solved: _Solved) -> None:
    """Carry out the plan of the job; evaluate, differentiate and save each solution."""
    job, body = prepared.job, prepared.body
    plan, all_equations = job.plan, prepared.equations
    solutions = carry_out(plan, all_equations, outputs, prepared.solutions)
    for number, (step, equations, solution) in enumerate(zip(plan, all_equations, solutions, strict=True)):
        solved.solutions.append(solution)
        outputs.report.check_reached(solved.solutions)
        if number == 0 or step.job.state:
            quantities = step.job.quantities
            if step.mesh is not None:
                quantities = carried(quantities, body, solution.mesh_nodes)
            solved.values |= evaluate(quantities, body, solution, equations)
            solved.quantities |= with_differences(job.quantities, solved.values)
            if parameters := job.differentiated:
                first = None if step.mesh is None else (solved.solutions[0], next(iter(solved.slopes.values())))
                solved.slopes[step.shape] = on_demand("sensitivities")(equations, solution, parameters, first)
            solved.spreads.add(step.shape, equations, solution)
            outputs.store.write_shape(job, equations, solution, outputs.progress)
        outputs.checkpoints.finished(solution)
    for quantity in job.quantities:  # in the order of the job
        solved.quantities[quantity.name] = solved.quantities.pop(quantity.name)


def _check(
    prepared: Prepared, outputs: _Outputs, solved: _Solved, end_late: Callable[[], NoReturn] | None
) -> tuple[Certificate, Estimate | None, SurfaceSpread | None]:
    """Check the solutions; return the certificate, the estimated error, and the spread by the given surface."""
    progress, spread = outputs.progress, solved.spreads.spread_of(outputs.job.quantities)
    observer = Observers(progress, outputs.stop) if outputs.checkpoints.can_save else progress
    late = None
    if end_late is not None and outputs.checkpoints.can_save and outputs.checkpoints.has_saved_finished:
        late = outputs.report.late_end(solved.solutions, end_late)
    try:
        with progress.phase("checking"), ended_late(late):
            certificate, estimate = certify_all(
                prepared.equations,
                solved.solutions,
                outputs.job.quantities,
                solved.values,
                prepared.estimate,
                spread.deviations() if spread else {},
                progress.detail,
                observer,
            )
    except Stopped:
        outputs.checkpoints.save_finished()
        outputs.report.end_stopped(solved.solutions)
    return certificate, estimate, spread
