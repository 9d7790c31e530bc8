"""The flow of a run: job → body → model → solution in each direction → certificate → result."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from hpcinv.accuracy import AccuracyRecord, Search
from hpcinv.certificate import Estimate, certify
from hpcinv.job.job import Job
from hpcinv.job.mesh_generators import is_generator
from hpcinv.mesh.moved import placed
from hpcinv.mesh.source import Floats
from hpcinv.methods import solve_direction
from hpcinv.methods.initial_guess import Guess
from hpcinv.methods.method import Start
from hpcinv.output.checkpoint_writer import CheckpointWriter
from hpcinv.output.progress import Progress
from hpcinv.output.result import Result
from hpcinv.output.run_directory import RunDirectory
from hpcinv.output.run_report import RunReport
from hpcinv.output.run_store import RunStore
from hpcinv.parallel.runtime import MPI, compilation_explained
from hpcinv.parallel.timings import Timings
from hpcinv.results.quantities_of_interest import check_points, evaluate
from hpcinv.results.shape_distance import differences, read_expected
from hpcinv.results.solution import Solution, solution_of
from hpcinv.results.totals import totals_of
from hpcinv.sensitivity.analysis import sensitivities
from hpcinv.solver.observer import Observer, Observers, StopSignal
from hpcinv.solver.problem import Model
from hpcinv.solver.problem_cache import Workspace


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
    guess: Guess | None = None,
) -> Result:
    """Solve a job on all ranks of ``comm``; collective.

    Args:
        directory: of checkpoints and results; ``None`` writes nothing.
        overwrite: whether results of another run may be replaced.
        resume: continue from the last checkpoint in ``directory``, if there is one.
        stop_asked: called on every rank before each Newton iteration; true saves a checkpoint and ends the run.
        workspace: body and model of earlier runs on ``comm``, to be used again by this run and later ones.
        guess: initial guess in the first direction at full load; without it, or if it fails, the unloaded body.

    Raises:
        MeshError, OutputError, CheckpointError, SystemPartMissing: the same on every rank.
        SolveError: the load was not reached; the diagnosis is in the message and in ``summary.json``.
        Interrupted: ``stop_asked`` was true on some rank.
    """
    with ExitStack() as own, compilation_explained(comm):
        workspace = workspace or own.enter_context(Workspace(comm))
        progress = progress or own.enter_context(Progress(comm, None))
        store = own.enter_context(RunStore(directory, comm))
        stop, timings = StopSignal(stop_asked), Timings()
        if resume:
            store.lock()
        problem = (_search if job.accuracy else _prepare)(job, workspace, progress, timings, stop)
        model, solutions = problem.model, list(problem.solutions)
        job, body = model.job, model.body

        checkpoints, restart = store.open(model, progress, overwrite=overwrite, resume=resume)
        with progress.phase("compiling"):
            totals = totals_of(model, job.directions[0])
        progress.body(totals)
        report = RunReport(model, store, progress, totals, problem.record, problem.unused_options)
        checkpoint_writer = CheckpointWriter(checkpoints, store, model)
        observer = Observers(progress, checkpoint_writer, report, stop)
        if not solutions:
            start = (restart and restart.start(0, model)) or Start(guess=guess)
            solutions.append(_solve(model, solutions, start, observer, report, progress))
        report.check_reached(solutions)
        quantities = evaluate(job.quantities, body, solutions[0], model)
        slopes = sensitivities(model, solutions[0])
        store.write_shape(model, solutions[0], slopes, progress)
        if len(job.directions) == 2:  # solve back from the body that was just found
            checkpoint_writer.finished(solutions[0])
            with placed(body.mesh, solutions[0].other_nodes / body.length_scale):
                start = (restart and restart.start(1, model)) or Start()
                solutions.append(_solve(model, solutions, start, observer, report, progress))
            report.check_reached(solutions)

        with progress.phase("checking"):
            certificate, estimate = certify(model, solutions, quantities, problem.estimate, progress.detail, progress)
        errors = differences(body, solutions, problem.expected)
        return report.conclude(solutions, certificate, quantities, errors, estimate, slopes)


@dataclass(frozen=True)
class _Problem:
    """The equations of a run; after a search for accuracy also the first solution and its estimated error."""

    model: Model
    expected: Floats | None = None  # local nodes of the expected shape, (n, 3) in m
    solutions: tuple[Solution, ...] = ()
    record: AccuracyRecord | None = None
    estimate: Estimate | None = None
    unused_options: Sequence[str] = ()


def _prepare(job: Job, workspace: Workspace, progress: Progress, timings: Timings, _stop: Observer) -> _Problem:
    """Return the equations of a job on its mesh; collective."""
    verb = "meshing" if is_generator(Path(job.mesh.file)) else "reading"
    with timings("mesh"), progress.phase(verb, job.mesh.file):
        body = workspace.body(job, progress.detail)
        progress.detail(f"{sum(body.partition.cells):,} cells")
        expected = read_expected(job, body)
        check_points(job.quantities, body)
    return _Problem(workspace.model(job, body, timings), expected)


def _search(job: Job, workspace: Workspace, progress: Progress, timings: Timings, stop: Observer) -> _Problem:
    """Return the equations on a mesh and in spaces that meet the accuracy that the job demands; collective."""
    with progress.phase("searching", "for mesh and degree"):
        record, best = Search(job, workspace.comm, timings, progress.note, stop).run()
    return _Problem(best.model, None, (best.solution,), record, best.estimate, best.unused_options)


def _solve(
    model: Model, before: Sequence[Solution], start: Start, observer: Observer, report: RunReport, progress: Progress
) -> Solution:
    """Solve in the direction that follows those ``before``; collective."""
    direction = model.job.directions[len(before)]
    with progress.phase("solving", announced=False):
        found = solve_direction(model, direction, start, observer)
        report.check_not_stopped(before, found)
        return solution_of(model, direction, model.scene(direction), found.solves, found.load, found.linear)
