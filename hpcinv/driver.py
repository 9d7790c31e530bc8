"""The flow of a run: job → body → model → continuation, leg by leg → result."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
from dolfinx import fem

from hpcinv.accuracy import AccuracyRecord, Search
from hpcinv.certificate import Certificate, Estimate, Line, Verdict, certify
from hpcinv.errors import CheckpointError, Interrupted, SolveError
from hpcinv.files.directory_lock import DirectoryLock
from hpcinv.job.fingerprint import fingerprint
from hpcinv.job.mesh_generators import is_generator
from hpcinv.mesh import write_mesh
from hpcinv.methods import method_for
from hpcinv.methods.initial_guess import Guess
from hpcinv.model.outcome import Outcome
from hpcinv.output.checkpoint import Checkpoints, Position, Restart, cells_digest
from hpcinv.output.progress import Progress
from hpcinv.output.result import Result
from hpcinv.output.run_directory import RunDirectory, relative
from hpcinv.output.summary import statistics, versions, write_summary
from hpcinv.output.vtk import write_fields
from hpcinv.parallel.runtime import MPI, compilation_explained, on_root
from hpcinv.parallel.timings import Timings
from hpcinv.results.leg import Leg, leg_of
from hpcinv.results.quantities_of_interest import check_points, evaluate
from hpcinv.results.shape_distance import closure, distance, read_expected
from hpcinv.results.totals import Totals, totals_of
from hpcinv.sensitivity.analysis import Sensitivities, sensitivities
from hpcinv.solver.diagnosis import diagnose
from hpcinv.solver.equilibrium import Solve
from hpcinv.solver.problem_cache import Workspace

if TYPE_CHECKING:
    from hpcinv.effects import Direction
    from hpcinv.job.job import Job
    from hpcinv.mesh.source import Floats


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
        directory: where checkpoints and results go; ``None`` writes nothing.
        overwrite: whether results of another run may be replaced.
        resume: go on from the last checkpoint in ``directory``, if there is one.
        stop_asked: asked on every rank before each Newton iteration; true saves a checkpoint and ends the run.
        workspace: what earlier runs on ``comm`` have left to use again, and this one will.
        guess: where to begin the first leg, at full load; without, or where that fails, with the unloaded body.

    Raises:
        MeshError, OutputError, CheckpointError, SystemPartMissing: the same on every rank.
        SolveError: the load was not reached; the diagnosis is in the message and in ``summary.json``.
        Interrupted: ``stop_asked`` was true on some rank.
    """
    where = RunDirectory(directory) if isinstance(directory, Path) else directory
    with ExitStack() as own, compilation_explained(comm):
        workspace = workspace or own.enter_context(Workspace(comm))
        progress = progress or own.enter_context(Progress(comm, None))
        started = _Run(job, comm, where, progress, stop_asked, workspace, guess)
        own.callback(started.unlock)
        return started.go(overwrite=overwrite, resume=resume)


class _Run:
    def __init__(
        self,
        job: Job,
        comm: MPI.Intracomm,
        directory: RunDirectory | None,
        progress: Progress,
        stop_asked: Callable[[], bool],
        workspace: Workspace,
        guess: Guess | None,
    ) -> None:
        self.job, self.comm, self.directory = job, comm, directory
        self.progress, self.stop_asked = progress, stop_asked
        self.workspace, self.guess = workspace, guess
        self.timings = Timings()
        self.legs: list[Leg] = []
        self.since_checkpoint, self.last_checkpoint = 0, time.monotonic()  # accepted steps; rank 0's time
        self.unused_options: list[str] = []
        self.record: AccuracyRecord | None = None
        self.estimate: Estimate | None = None
        self.totals: Totals | None = None
        self.lock: DirectoryLock | None = None  # on rank 0

    def go(self, *, overwrite: bool, resume: bool) -> Result:
        if self.directory is not None and resume:
            on_root(self.comm, self._lock)
        expected = None if self.job.accuracy else self._prepare()
        if self.job.accuracy:
            self._search()
        job = self.job
        self.checkpoints, restart = self._open(overwrite=overwrite, resume=resume)
        with self.progress.phase("compiling"):
            self.totals = totals_of(self.model, job.legs[0])
        self.progress.body(self.totals)

        for number, direction in enumerate(job.legs):
            if number == len(self.legs):  # else the search has solved it
                with self.progress.phase("solving", announced=False):
                    self._solve(number, direction, restart)
            if self.legs[-1].load != 1.0:
                self._give_up(self.legs[-1])
            if number == 0:
                quantities = evaluate(job.quantities, self.body, self.legs[0], self.model)
                slopes = sensitivities(self.model, self.legs[0])
                with self.progress.phase("writing"):
                    self._write_shape(slopes)
            if number + 1 < len(job.legs):
                # The next leg is solved on the body that was just found.
                self.body.mesh.geometry.x[:] = self.legs[-1].other_nodes / self.body.length_scale

        errors = {}
        if expected is not None:
            errors["expected_shape"] = distance(self.body, self.legs[0], expected)
        if len(self.legs) == 2:
            errors["round_trip"] = closure(*self.legs)
        with self.progress.phase("checking"):
            certificate, found = certify(self.model, self.legs, quantities, self.estimate, self.progress.detail)
        if self.record is not None:
            certificate = Certificate((*certificate.lines, *self.record.lines()))
        self._judge_displacement()
        result = Result(job, self.body, tuple(self.legs), certificate, quantities, errors, found, slopes)
        return self._finish(result, "converged")

    def _judge_displacement(self) -> None:
        """Warn where the body hardly moves, unless it was foreseen."""
        before = self.totals
        if before is not None and self.job.output.unit_warnings and not before.warnings:
            self.totals = before.after(self.legs[0].largest_displacement)
            for text in self.totals.warnings:
                self.progress.warn(text)

    def _prepare(self) -> Floats | None:
        """Body and model as the job gives them, and the local nodes of the expected shape."""
        job = self.job
        verb = "meshing" if is_generator(Path(job.mesh.file)) else "reading"
        with self.timings("mesh"), self.progress.phase(verb, job.mesh.file):
            self.body = self.workspace.body(job, self.progress.detail)
            self.progress.detail(f"{sum(self.body.partition.cells):,} cells")
            expected = read_expected(job, self.body)
            check_points(job.quantities, self.body)
        self.model = self.workspace.model(job, self.timings)
        self.model.told = self.progress.iteration
        return expected

    def _search(self) -> None:
        """Body, model and first leg as the demands on the accuracy want them."""
        search = Search(self.job, self.comm, self.timings, self.progress.note, self.stop_asked)
        with self.progress.phase("searching", "for mesh and degree"):
            self.record, best = search.run(), search.best
        self.job, self.body, self.model, self.legs = best.job, best.body, best.model, [best.leg]
        self.estimate, self.unused_options = best.estimate, best.unused_options

    def _open(self, *, overwrite: bool, resume: bool) -> tuple[Checkpoints | None, Restart | None]:
        """Make or find the run directory, now that the job is known to be right."""
        if self.directory is None:
            return None, None
        directory, job = self.directory, self.job
        # Functions are saved cell by cell: a generator must have made the same cells again.
        problem = on_root(self.comm, lambda: fingerprint(job)) | {"cells": cells_digest(self.body)}
        # A search for accuracy saves nothing and begins anew.
        checkpoints = None
        if not job.accuracy:
            checkpoints = Checkpoints(directory.checkpoints, self.comm, problem, job.checkpoint.keep)
        restart = checkpoints.latest() if checkpoints and resume else None
        if not resume or checkpoints is None:
            on_root(self.comm, lambda: self._create(overwrite=overwrite or resume))
        elif not on_root(self.comm, lambda: directory.holds(job)):
            on_root(self.comm, lambda: directory.change(job))
        self.progress.open_log(self.comm, directory.path, ", ".join(f"{k} {v}" for k, v in versions().items()))
        self.progress.begin(job, self.body, self.model.unknowns.size, directory.path, restart)
        return checkpoints, restart

    def _lock(self) -> None:
        assert self.directory is not None
        self.lock = self.directory.lock()

    def _create(self, *, overwrite: bool) -> None:
        assert self.directory is not None
        self.unlock()  # it is locked again between there and here
        self.lock = self.directory.create(self.job, overwrite=overwrite)

    def unlock(self) -> None:
        """Let other processes have the directory."""
        if self.lock is not None:
            self.lock.release()
            self.lock = None

    def _check_directory(self) -> None:
        """Raise ``OutputError`` on all ranks if the directory was removed meanwhile, before it is written to."""
        if (directory := self.directory) is not None:
            on_root(self.comm, lambda: directory.check_in_place(self.lock))

    def _solve(self, number: int, direction: Direction, restart: Restart | None) -> None:
        """One leg: from the unloaded body, or from the checkpoint, to the full load."""
        model = self.model
        resumed = restart is not None and restart.position.leg >= number
        model.unknowns.state.x.array[:] = 0.0
        load, solves = self._take_up(number, restart) if restart and resumed else (0.0, list[Solve]())
        method = method_for(model, direction, self.stop_asked)
        method.turned = sum(solve.turning_point for solve in solves)
        method.guess = None if number or resumed else self.guess
        self.progress.leg(direction, method.equilibrium.used)
        stop, begin, every = False, load, self.job.checkpoint.every
        for solve in method.solves(load, resumed=resumed):
            self.progress.solve(solve, self._largest_displacement(), method.min_mesh_J())
            interrupted = solve.outcome is Outcome.INTERRUPTED
            if not interrupted:  # else the resumed run does it
                solves.append(solve)
            if method.can_restart_after(solve):
                self.since_checkpoint += 1
            if every and self.since_checkpoint >= every and self._checkpoint_is_due():
                self._checkpoint(number, method.reached, solves)
            stop = self.comm.allreduce(self.stop_asked() or interrupted, op=MPI.LOR)
            if stop:
                break
        load = method.reached
        if begin != 1.0:  # else nothing was solved, and PETSc asked for nothing
            self.unused_options = method.equilibrium.options.unused()
        model.release(method.equilibrium)
        if self.since_checkpoint and (stop or (every and load != 1.0)):
            self._checkpoint(number, load, solves)
        if stop and (load != 1.0 or number + 1 < len(self.job.legs)):
            restartable = number > 0 or load > 0 or any(map(method.can_restart_after, solves))
            raise self._interrupted(direction, load, saved=restartable)
        scene = model.scene(direction)
        scene.parameters.set_load(load)
        self.legs.append(leg_of(model, direction, scene, tuple(solves), load, method.equilibrium.used))

    def _take_up(self, number: int, restart: Restart) -> tuple[float, list[Solve]]:
        """Make the state of a checkpoint the model's; its load factor in this leg, and the solves that led to it."""
        u, p = self.model.solution()
        for name, function in _named(number, u, p).items():
            restart.read(name, function)
        self.model.set_solution(u, p)
        load = restart.position.load if restart.position.leg == number else 1.0
        return load, list(restart.position.solves[number])

    def _checkpoint_is_due(self) -> bool:
        """Whether the last one is long enough ago, by the clock of rank 0."""
        least = self.job.checkpoint.seconds
        return not least or bool(self.comm.bcast(time.monotonic() - self.last_checkpoint >= least))

    def _checkpoint(self, number: int, load: float, solves: list[Solve]) -> None:
        self.since_checkpoint, self.last_checkpoint = 0, time.monotonic()
        if self.checkpoints is None:
            return
        self._check_directory()
        with self.timings("checkpoint"):
            position = Position(number, load, (*(leg.solves for leg in self.legs), tuple(solves)))
            solutions = [*((leg.displacement, leg.pressure) for leg in self.legs), self.model.solution()]
            named = (_named(leg, *solution) for leg, solution in enumerate(solutions))
            try:
                self.checkpoints.write(position, {name: f for part in named for name, f in part.items()})
            except CheckpointError:  # not on all ranks
                if self.directory is not None:
                    self.directory.check_in_place(None)
                raise

    def _largest_displacement(self) -> float:
        u = self.model.unknowns.displacement().x.array.reshape(-1, 3)
        largest = float((u**2).sum(axis=1).max(initial=0.0)) ** 0.5 * self.model.scales.length
        return float(self.comm.allreduce(largest, op=MPI.MAX))

    def _write_shape(self, slopes: Sensitivities | None) -> None:
        if self.directory is None:
            return
        self._check_directory()
        with self.timings("output"):
            for suffix in self.job.shape_formats:
                self.progress.detail(f"shape.{suffix}")
                write_mesh(self.directory.path / f"shape.{suffix}", self.body, self.legs[0].other_nodes)
            if self.job.output.fields:
                self.progress.detail("fields")
                write_fields(self.directory.path / "fields", self.body, self.legs[0], slopes.fields() if slopes else ())

    def _finish(self, result: Result, status: str) -> Result:
        result = replace(result, directory=self.directory.path if self.directory else None)
        result = replace(result, accuracy=self.record, totals=self.totals)
        found = self._write_summary(result, status)
        self.progress.finish(found)
        return replace(result, statistics=found)

    def _write_summary(self, result: Result, status: str) -> dict[str, Any]:
        found = statistics(result, status, self.model.unknowns.size, self.unused_options, self.timings, self.comm)
        if self.directory is not None:
            self._check_directory()
            write_summary(self.directory.path, found, self.comm, formats=self.job.output.summary)
        return found

    def _give_up(self, leg: Leg) -> None:
        """Tell how far it came, and leave what was reached in the summary and the checkpoint."""
        gaps = [s.gap for s in leg.solves if s.gap is not None]
        why = leg.solves[-1].outcome if gaps else diagnose(leg.direction, leg.solves)
        if gaps:
            where = f"stopped {gaps[-1]:.3g} m from the given shape"
            line = Line("distance from the given shape", gaps[-1], "m", "must vanish", Verdict.FAIL, why.text)
        else:
            where = f"stopped at load factor {leg.load:.6g} of 1"
            line = Line("load factor", leg.load, "", "must reach 1", Verdict.FAIL, why.text)
        self._finish(Result(self.job, self.body, tuple(self.legs), Certificate((line,))), why.text)
        raise SolveError(f"{where}: {why.text}", why.advice)

    def _interrupted(self, direction: Direction, load: float, *, saved: bool) -> Interrupted:
        """The error that ends a run after a signal; its summary has the legs before this one, and how far this came."""
        why = "stopped by a signal"
        where = f"{why} in the {direction} solve at load factor {load:.6g}"
        if self.directory is None:
            return Interrupted(f"{where}; nothing was saved")
        line = Line("load factor", load, "", "must reach 1", Verdict.FAIL, why)
        result = Result(self.job, self.body, tuple(self.legs), Certificate((line,)))
        self._write_summary(replace(result, accuracy=self.record, totals=self.totals), why)
        saved = saved and self.checkpoints is not None
        return Interrupted(
            f"{where}; {'what was reached is saved' if saved else 'there was nothing to save yet'}",
            f"{'Go on with' if saved else 'Start it again with'}: "
            f"mpirun -n {self.comm.size} python -m hpcinv resume {relative(self.directory.path)}",
        )


def _named(leg: int, u: fem.Function, p: fem.Function | None) -> dict[str, fem.Function]:
    """The functions of one leg under the names that they have in a checkpoint."""
    functions = {f"displacement-{leg}": u}
    return functions if p is None else functions | {f"pressure-{leg}": p}
