"""Report of a run: its summary, and the error of a run that does not reach its end."""

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

from hpcinv.base.parallel.runtime import on_root
from hpcinv.base.quantity.written_units import written_units
from hpcinv.errors import HpcinvError, Interrupted, OutputError, SolveError
from hpcinv.job.job import Job
from hpcinv.job.quantity_of_interest import QuantityValue
from hpcinv.on_demand import on_demand
from hpcinv.output.progress import Level, Progress
from hpcinv.output.result import Result
from hpcinv.output.run_store import RunStore
from hpcinv.output.shape_files import lines_of
from hpcinv.output.summary import statistics, write_on_this_rank, write_summary
from hpcinv.output.surfaces.boundary_surface import NAME as BOUNDARY
from hpcinv.output.surfaces.boundary_surface import write_boundary
from hpcinv.output.surfaces.interior import NAME as INTERIOR
from hpcinv.output.surfaces.interior import write_interior
from hpcinv.physics.effects import Direction
from hpcinv.results.displacement_scale import nominal_sizes
from hpcinv.results.quantities_of_interest import NOT_FINITE, fault_of
from hpcinv.results.solution import Solution
from hpcinv.results.totals import Totals
from hpcinv.solver.equations import Equations
from hpcinv.solver.linear.selection import Used
from hpcinv.solver.newton import is_given_up
from hpcinv.solver.observer import Observer, SolvedDirection
from hpcinv.trust.accuracy import AccuracyRecord
from hpcinv.trust.certificate import Certificate, Line, Verdict, topic
from hpcinv.trust.certificate.check import with_line

LOAD_FACTOR = topic("load factor", "Share of the load that was reached.")
POSITION = topic("position residual", "Distance of the loaded body from the given one, which must vanish.")
END = topic("run", "Whether the run reached its end.")
COMPLETENESS = topic("certificate", "Whether all checks were made.")
NOT_FINITE_VALUES = topic(
    "quantities without a finite value", "Quantities of interest that are infinite, or not a number."
)


@dataclass
class RunReport(Observer):
    """Writes the summary of a run, and raises the error of a run that does not reach its end; methods are collective.

    Args:
        unused_options: PETSc options of the job that were not used so far.
        hints: explanation why load steps keep failing; two lines where the supports are the reason.
    """

    job: Job
    equations: Equations
    store: RunStore
    progress: Progress
    totals: Totals
    record: AccuracyRecord | None
    unused_options: Sequence[str]
    hints: Sequence[str] = ()

    def begun(self, direction: Direction, linear: Used) -> None:
        self.hints = ()

    def failing(self, lines: Sequence[str]) -> None:
        self.hints = lines

    def ended(self, solved: SolvedDirection) -> None:
        if solved.unused_options is not None:
            self.unused_options = solved.unused_options

    def conclude(self, result: Result) -> Result:
        """Write and print the summary of a converged run, with all lines of its certificate."""
        lines = [*result.certificate.lines, *lines_of(self.store.shape_files), *_not_finite(result)]
        if self.record is not None:
            units = getattr(result.quantities, "units", {})
            lines += self.record.lines(units, written_units(self.job.data), result.certificate.lines)
        if result.surface_spread is not None:
            lines += result.surface_spread.lines()
        if self.job.output.unit_warnings and not self.totals.warnings:  # warn of a body that hardly moves
            first = result.solutions[0]
            self.totals = self.totals.warned(
                first.largest_displacement, lambda: nominal_sizes(self.equations, first)[0]
            )
            for text in self.totals.warnings:
                self.progress.warn(text)
        return self._finish(replace(result, certificate=Certificate(tuple(lines))), "converged")

    def _finish(self, result: Result, status: str, advice: str = "") -> Result:
        result = self._write(result, status, advice)
        self.progress.finish(result.statistics)
        return result

    def check_reached(self, solutions: Sequence[Solution]) -> None:
        """Raise ``SolveError`` if the last direction did not reach the full load, which the summary then has."""
        solution = solutions[-1]
        if solution.load == 1.0:
            return
        residuals = [s.position_residual for s in solution.solves if s.position_residual is not None]
        diagnose = on_demand("diagnosis of a failure")
        why = solution.solves[-1].outcome if residuals else diagnose(solution.direction, solution.solves)
        if residuals:
            where = f"stopped {residuals[-1]:.3g} m from the given shape"
            line = Line(POSITION, residuals[-1], "m", "must vanish", Verdict.FAIL, why.text)
        else:
            where = f"stopped at load factor {solution.load:.6g} of 1"
            line = Line(LOAD_FACTOR, solution.load, "", "must reach 1", Verdict.FAIL, why.text)
        if solution.state:
            where, line = f"state '{solution.state}': {where}", replace(line, state=solution.state)
        patience = self.job.solver.patience
        advice = "\n  ".join(self.hints) if len(self.hints) > 1 else why.advice
        if is_given_up(solution.solves, patience):
            advice = f"Given up after {patience} factorizations in failed solves (solver.patience). {advice}"
        self._finish(self._unfinished(solutions, line), why.text, advice)
        raise SolveError(f"{where}: {why.text}", advice)

    def check_not_stopped(self, earlier: Sequence[Solution], solved: SolvedDirection, state: str) -> None:
        """Raise ``Interrupted`` if a request to stop ended the run before its last solve.

        The summary then has the solutions before this direction (``earlier``), and the load factor that it reached.
        """
        job = self.job
        if not solved.stopped or (solved.load == 1.0 and len(earlier) + 1 == len(job.directions)):
            return
        why = "stopped by a signal"
        state_text = f" of state '{state}'" if state else ""
        where = f"{why} in the {solved.direction} solve{state_text} at load factor {solved.load:.6g}"
        if self.store.path is None:
            raise Interrupted(f"{where}; nothing was saved")
        line = Line(LOAD_FACTOR, solved.load, "", "must reach 1", Verdict.FAIL, why, state=state)
        self._write(self._unfinished(earlier, line), why)
        saved = not job.accuracy and (bool(earlier) or solved.can_restart)
        raise Interrupted(
            f"{where}; {'its state is saved' if saved else 'there was no state to save yet'}",
            self._go_on(self.store.path, "Go on with" if saved else "Start it again with"),
        )

    @contextmanager
    def keeping(self, solutions: Sequence[Solution], quantities: Mapping[str, QuantityValue]) -> Iterator[None]:
        """Context that writes a summary of the present solutions if an error ends the run after the first of them."""
        try:
            yield
        except (SolveError, Interrupted):  # they have their summary
            raise
        except HpcinvError as error:
            if solutions:
                line = Line(END, None, "", "must reach its end", Verdict.FAIL, error.message)
                unfinished = replace(self._unfinished(solutions, line), quantities=dict(quantities))
                with suppress(OutputError):  # the first error is the one to show
                    self._write(unfinished, error.message, error.advice)
            raise

    def end_stopped(self, solutions: Sequence[Solution]) -> NoReturn:
        """Raise ``Interrupted`` for a run that a request to stop ended after its last solve, whose state is saved."""
        assert self.store.path is not None
        self._write(self._unfinished(solutions, _INCOMPLETE), _STOPPED)
        raise Interrupted(_STOPPED_THERE, self._go_on(self.store.path))

    def with_second_opinion(self, result: Result) -> Result:
        """Return a result that was written, with what another program finds of it; collective."""
        store, path = self.store, self.store.path
        if path is None:
            line = _NO_FILES
        else:
            with self.progress.phase("second opinion"):
                line = on_root(store.comm, lambda: on_demand("second opinion")(path))
        certificate = Certificate((*result.certificate.lines, line))
        data = with_line(result.statistics["certificate"], line)
        result = replace(result, certificate=certificate, statistics={**result.statistics, "certificate": data})
        self.progress.note(f"{line.verdict.value}: second opinion: {line.note}", Level.QUIET)
        if path is not None and self.job.output.report:
            on_root(store.comm, lambda: on_demand("report of a run")(path, result.statistics))
        return result

    def late_end(self, solutions: Sequence[Solution], end: Callable[[], NoReturn]) -> Callable[[], None]:
        """Return a function that ends a run within a check, as `end_stopped` does, but on one rank; collective.

        Args:
            end: ends all ranks.
        """
        path = self.store.path
        assert path is not None
        result = replace(self._unfinished(solutions, _INCOMPLETE), directory=path, totals=self.totals)
        content, is_first = self._content(result, _STOPPED), self.store.comm.rank == 0

        def end_with_summary() -> None:
            if not is_first:
                time.sleep(1.0)  # the first rank, if it has the signal too, ends all
            with suppress(OutputError):
                write_on_this_rank(path, content, ["json"])
            print(f"{_STOPPED_THERE}\n  {self._go_on(path)}", file=sys.stderr)
            end()

        return end_with_summary

    def _go_on(self, path: Path, verb: str = "Go on with") -> str:
        return f"{verb}: mpirun -n {self.store.comm.size} python -m hpcinv resume {os.path.relpath(path)}"

    def _unfinished(self, solutions: Sequence[Solution], line: Line) -> Result:
        return Result(self.job, self.equations.body, tuple(solutions), Certificate((line,)))

    def _content(self, result: Result, status: str, advice: str = "") -> dict[str, Any]:
        """Return the content of ``summary.json``; collective."""
        equations, store, size = self.equations, self.store, self.equations.unknowns.size
        content = statistics(result, status, size, self.unused_options, equations.timings, store.comm, advice=advice)
        content["unwritten"] = [error.message for error in store.unwritten]
        content["shape_files"] = {file.name: file.left_out for file in store.shape_files.values()}
        return content

    def _write(self, result: Result, status: str, advice: str = "") -> Result:
        equations, store = self.equations, self.store
        result = replace(result, directory=store.path, accuracy=self.record, totals=self.totals)
        content = self._content(result, status, advice)
        if (path := store.path) is not None:
            store.check_in_place()
            if status == "converged" and self.job.output.fields:
                with equations.timings("output"):
                    result.write_fields(path / "fields")
            if result.solutions and self.job.output.has_surface:
                with equations.timings("output"):
                    boundary, interior = result.boundary(), result.interior()

                    def write() -> None:
                        if boundary is not None and interior is not None:
                            write_boundary(path / BOUNDARY, boundary)
                            write_interior(path / INTERIOR, interior)

                    on_root(store.comm, write)
            # Last is summary.json, which marks the run as finished.
            others = [form for form in self.job.output.summary if form != "json"]
            write_summary(path, content, store.comm, formats=others)
            try:
                if self.job.output.report:
                    on_root(store.comm, lambda: on_demand("report of a run")(path, content))
            finally:  # the results are kept if there is an error in the report, which 'report' writes again
                write_summary(path, content, store.comm, formats=["json"])
        return replace(result, statistics=content)


_NO_FILES = Line(
    topic("second opinion of a run without files", "Whether another program was asked."),
    None,
    "",
    "",
    Verdict.UNDECIDED,
    "needs the directory of a run, which cases of a sweep and runs in Python without one lack",
)
_STOPPED = "stopped by a signal"
_STOPPED_THERE = f"{_STOPPED} in the certificate; the solution is saved"
_INCOMPLETE = Line(COMPLETENESS, None, "", "must be complete", Verdict.UNDECIDED, _STOPPED)


def _not_finite(result: Result) -> Iterator[Line]:
    """Yield a warning if quantities of interest have no finite value."""
    known = [(q, result.quantities[q.name]) for q in result.job.quantities if q.name in result.quantities]
    if faults := [fault for quantity, value in known if (fault := fault_of(quantity, value))]:
        rule = "number; warning above 0"
        note = f"{'; '.join(faults)}; {NOT_FINITE}"
        yield Line(NOT_FINITE_VALUES, float(len(faults)), "", rule, Verdict.WARN, note)
