"""Report of a run: its summary, and the error of a run that does not reach its end."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace

from hpcinv.accuracy import AccuracyRecord
from hpcinv.certificate import Certificate, Estimate, Line, Verdict
from hpcinv.errors import Interrupted, SolveError
from hpcinv.job.job import Job
from hpcinv.output.progress import Progress
from hpcinv.output.result import Result
from hpcinv.output.run_store import RunStore
from hpcinv.output.summary import statistics, write_summary
from hpcinv.parallel.runtime import on_root
from hpcinv.pictures.boundary import NAME as BOUNDARY
from hpcinv.pictures.boundary import write_boundary
from hpcinv.results.quantities_of_interest import Value
from hpcinv.results.solution import Solution
from hpcinv.results.totals import Totals
from hpcinv.sensitivity.analysis import Sensitivities
from hpcinv.sensitivity.surface_errors import SurfaceSpread
from hpcinv.solver.diagnosis import diagnose
from hpcinv.solver.observer import Observer, SolvedDirection
from hpcinv.solver.problem import Model


class RunReport(Observer):
    """Writes the summary of a run, and raises the error of a run that does not reach its end; methods are collective.

    Args:
        unused_options: PETSc options of the job that were not used so far.
    """

    def __init__(
        self,
        job: Job,
        model: Model,
        store: RunStore,
        progress: Progress,
        totals: Totals,
        record: AccuracyRecord | None,
        unused_options: Sequence[str],
    ) -> None:
        self._job, self._model, self._store, self._progress = job, model, store, progress
        self._totals, self._record, self._unused_options = totals, record, unused_options

    def ended(self, found: SolvedDirection) -> None:
        if found.unused_options is not None:
            self._unused_options = found.unused_options

    def conclude(
        self,
        solutions: Sequence[Solution],
        certificate: Certificate,
        quantities: Mapping[str, Value],
        errors: Mapping[str, Mapping[str, float]],
        estimate: Estimate | None,
        slopes: Sensitivities | None,
        spread: SurfaceSpread | None,
    ) -> Result:
        """Write and print the summary of a converged run; the arguments are those of `Result`."""
        if self._record is not None:
            certificate = Certificate((*certificate.lines, *self._record.lines()))
        if spread is not None:
            certificate = Certificate((*certificate.lines, *spread.lines()))
        self._check_displacement(solutions[0])
        body = self._model.body
        result = Result(self._job, body, tuple(solutions), certificate, quantities, errors, estimate, slopes, spread)
        return self._finish(result, "converged")

    def _check_displacement(self, solution: Solution) -> None:
        """Warn if the body hardly moves, unless there was a warning before."""
        if self._job.output.unit_warnings and not self._totals.warnings:
            self._totals = self._totals.after(solution.largest_displacement)
            for text in self._totals.warnings:
                self._progress.warn(text)

    def _finish(self, result: Result, status: str, advice: str = "") -> Result:
        result = self._write(result, status, advice)
        self._progress.finish(result.statistics)
        return result

    def check_reached(self, solutions: Sequence[Solution]) -> None:
        """Raise ``SolveError`` if the last direction did not reach the full load, which the summary then has."""
        solution = solutions[-1]
        if solution.load == 1.0:
            return
        residuals = [s.position_residual for s in solution.solves if s.position_residual is not None]
        why = solution.solves[-1].outcome if residuals else diagnose(solution.direction, solution.solves)
        if residuals:
            where = f"stopped {residuals[-1]:.3g} m from the given shape"
            line = Line("position residual", residuals[-1], "m", "must vanish", Verdict.FAIL, why.text)
        else:
            where = f"stopped at load factor {solution.load:.6g} of 1"
            line = Line("load factor", solution.load, "", "must reach 1", Verdict.FAIL, why.text)
        if solution.state:
            where, line = f"state '{solution.state}': {where}", replace(line, state=solution.state)
        self._finish(self._unfinished(solutions, line), why.text, why.advice)
        raise SolveError(f"{where}: {why.text}", why.advice)

    def check_not_stopped(self, before: Sequence[Solution], found: SolvedDirection, state: str) -> None:
        """Raise ``Interrupted`` if a request to stop ended the run before its last solve.

        The summary then has the solutions ``before`` this direction, and the load factor that it reached.
        """
        job = self._job
        if not found.stopped or (found.load == 1.0 and len(before) + 1 == len(job.directions)):
            return
        why = "stopped by a signal"
        of_state = f" of state '{state}'" if state else ""
        where = f"{why} in the {found.direction} solve{of_state} at load factor {found.load:.6g}"
        if self._store.path is None:
            raise Interrupted(f"{where}; nothing was saved")
        line = Line("load factor", found.load, "", "must reach 1", Verdict.FAIL, why, state=state)
        self._write(self._unfinished(before, line), why)
        saved = not job.accuracy and (bool(before) or found.can_restart)
        raise Interrupted(
            f"{where}; {'its state is saved' if saved else 'there was no state to save yet'}",
            f"{'Go on with' if saved else 'Start it again with'}: "
            f"mpirun -n {self._store.comm.size} python -m hpcinv resume {os.path.relpath(self._store.path)}",
        )

    def _unfinished(self, solutions: Sequence[Solution], line: Line) -> Result:
        return Result(self._job, self._model.body, tuple(solutions), Certificate((line,)))

    def _write(self, result: Result, status: str, advice: str = "") -> Result:
        model, store = self._model, self._store
        result = replace(result, directory=store.path, accuracy=self._record, totals=self._totals)
        size = model.unknowns.size
        found = statistics(result, status, size, self._unused_options, model.timings, store.comm, advice=advice)
        if (path := store.path) is not None:
            store.check_in_place()
            if status == "converged" and self._job.output.fields:
                with model.timings("output"):
                    result.write_fields(path / "fields")
            if result.solutions and self._job.output.has_surface:
                with model.timings("output"):
                    boundary = result.boundary()

                    def write() -> None:
                        if boundary is not None:
                            write_boundary(path / BOUNDARY, boundary)

                    on_root(store.comm, write)
            write_summary(path, found, store.comm, formats=self._job.output.summary)
            if self._job.output.report:
                from hpcinv.reports.of_run import write_run_report  # loads VTK

                on_root(store.comm, lambda: write_run_report(path, found))
        return replace(result, statistics=found)
