"""The flow of a run: job → body → model → solution in each direction or state → certificate → result."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from hpcinv.certificate import certify_all
from hpcinv.job.job import Job
from hpcinv.mesh.moved import placed
from hpcinv.methods import solve_direction
from hpcinv.methods.method import Guess, Start
from hpcinv.methods.nested_iteration import solve_nested
from hpcinv.output.checkpoint_writer import CheckpointWriter
from hpcinv.output.progress import Progress
from hpcinv.output.result import Result
from hpcinv.output.run_directory import RunDirectory
from hpcinv.output.run_report import RunReport
from hpcinv.output.run_store import RunStore
from hpcinv.output.snapshot_writer import SnapshotWriter
from hpcinv.parallel.runtime import MPI, compilation_explained
from hpcinv.parallel.timings import Timings
from hpcinv.preparation import prepare
from hpcinv.results.quantities_of_interest import Value, carried, evaluate
from hpcinv.results.shape_distance import differences
from hpcinv.results.solution import solution_of
from hpcinv.results.totals import totals_of
from hpcinv.sensitivity.analysis import Sensitivities, of_all_shapes, sensitivities
from hpcinv.sensitivity.surface_errors import SurfaceSpreads
from hpcinv.solver.observer import Observers, Stopped, StopSignal
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
    guesses: Sequence[Guess] = (),
) -> Result:
    """Solve a job on all ranks of ``comm``; collective.

    Args:
        directory: of checkpoints and results; ``None`` writes nothing.
        overwrite: whether results of another run may be replaced.
        resume: continue from the last checkpoint in ``directory``, if there is one.
        stop_asked: called on every rank before each Newton iteration, and where else a run can stop: before it solves,
            and in the certificate if there is a directory for checkpoints; true saves a checkpoint and ends the run.
        workspace: body and model of earlier runs on ``comm``, to be used again by this run and later ones.
        guesses: initial guesses of the first solves at full load; without one, or if it fails, the unloaded body.

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
            store.lock(job)
        problem = prepare(job, workspace, progress, timings, stop)
        job, models, solutions = problem.job, problem.models, list(problem.solutions)
        model = models.of(0)
        body = model.body

        checkpoints, restart = store.open(job, model, progress, overwrite=overwrite, resume=resume)
        with progress.phase("compiling"):
            totals = totals_of(model, job.directions[0])
        progress.body(totals)
        report = RunReport(job, model, store, progress, totals, problem.record, problem.unused_options)
        checkpoint_writer = CheckpointWriter(checkpoints, store, model, restart)
        snapshots = SnapshotWriter(store, model, restart)
        observer = Observers(progress, checkpoint_writer, snapshots, report, stop)
        quantities: dict[str, Value] = {}
        slopes: dict[str, Sensitivities] = {}
        spreads = SurfaceSpreads(job, body)
        own.enter_context(report.keeping(solutions, quantities))
        for number, solve in enumerate(models.plan):
            model = models.of(number, solutions[0].displacement if number else None)
            if number == len(solutions):
                nodes = None if solve.mesh is None else solutions[solve.mesh].other_nodes
                with placed(body.mesh, body.mesh.geometry.x if nodes is None else nodes / body.length_scale):
                    start = (restart and restart.start(number, model)) or Start(
                        guess=guesses[number] if number < len(guesses) else None
                    )
                    if solve.start is not None:
                        start = replace(start, origin=solutions[solve.start].fields)
                    progress.state(job, number)
                    snapshots.begin(number, model, solve.direction)
                    coarse = None
                    with progress.phase("solving", announced=False):
                        if number == 0 and start.is_unloaded:
                            found, coarse = solve_nested(model, solve.direction, observer, progress.note)
                        else:
                            found = solve_direction(model, solve.direction, start, observer)
                        report.check_not_stopped(solutions, found, model.job.state)
                        scene = model.scene(solve.direction)
                        solution = solution_of(model, solve.direction, scene, found.solves, found.load, found.linear)
                    before = "" if solve.start is None else solutions[solve.start].state
                    solutions.append(replace(solution, start=before, coarse=coarse))
            report.check_reached(solutions)
            solution = solutions[number]
            if number == 0 or solve.job.state:
                wanted = model.job.quantities
                if solve.mesh is not None:
                    wanted = carried(wanted, body, solution.mesh_nodes)
                quantities |= evaluate(wanted, body, solution, model)
                if parameters := job.differentiated:
                    given = None if solve.mesh is None else (solutions[0], next(iter(slopes.values())))
                    slopes[solve.shape] = sensitivities(model, solution, parameters, given)
                spreads.add(solve.shape, model, solution)
                store.write_shape(job, model, solution, progress)
            checkpoint_writer.finished(solution)
        quantities = {q.name: quantities[q.name] for q in job.quantities}

        spread = spreads.of(quantities)
        try:
            with progress.phase("checking"):
                certificate, estimate = certify_all(
                    models,
                    solutions,
                    quantities,
                    problem.estimate,
                    spread.deviations() if spread else {},
                    progress.detail,
                    Observers(progress, stop) if checkpoint_writer.can_save else progress,
                )
        except Stopped:
            checkpoint_writer.save_finished()
            report.end_stopped(solutions)
        errors = differences(body, solutions, problem.expected)
        of_all = of_all_shapes(slopes, quantities)
        return report.conclude(
            Result(job, body, tuple(solutions), certificate, quantities, errors, estimate, of_all, spread)
        )
