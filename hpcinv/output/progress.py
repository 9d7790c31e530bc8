"""Messages of a run on rank 0: phases, steps, a live bar on a terminal, the report, and the log."""

from __future__ import annotations

import math
import socket
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TextIO

from hpcinv.base.quantity.units import readable
from hpcinv.errors import HpcinvError
from hpcinv.on_demand import on_demand
from hpcinv.output.run_log import RunLog
from hpcinv.output.text_report import counted, report, short_report
from hpcinv.solver.observer import Observer

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm
    from rich.console import Console
    from rich.progress import Progress as LiveBar

    from hpcinv.job.job import Job
    from hpcinv.mesh import Body
    from hpcinv.output.checkpoint import Restart
    from hpcinv.physics.effects import Direction
    from hpcinv.results.totals import Totals
    from hpcinv.solver.linear.selection import Used
    from hpcinv.solver.newton import NewtonIteration
    from hpcinv.solver.observer import SolveEvent


class Level(IntEnum):
    """Level of the messages that are printed; the log has all of them."""

    QUIET = 0
    """warnings, lines of the certificate that do not pass, and the outcome"""
    NORMAL = 1
    """a line for each phase and step, and the report"""
    VERBOSE = 2
    """a line for each Newton iteration and each check"""


class Progress(Observer):
    """Messages of a run; silent without a stream, and on every rank but 0.

    Use it as a context, which always removes the live bar from the terminal and closes the log.
    """

    def __init__(self, comm: Intracomm, stream: TextIO | None, level: Level = Level.NORMAL) -> None:
        self.level = level
        self._console: Console | None = None
        if stream is not None and comm.rank == 0:
            from hpcinv.output.console import run_console  # rich is slow to import

            self._console = run_console(stream)
        self._log = RunLog(written=comm.rank == 0)
        self._ranks = comm.size
        self._bar: LiveBar | None = None
        self._direction = ""
        self._set_up = "factorization"  # or "tangent": there is one for each new preconditioner
        self._directory = ""
        self._phase: _Phase | None = None
        self._last = time.perf_counter()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _kind: type[BaseException] | None, error: BaseException | None, _trace: object) -> None:
        self._break_line()
        self.close()
        if error is not None:
            text = str(error) if isinstance(error, HpcinvError) else "".join(traceback.format_exception(error))
            self._log.write(f"ended by an error: {text}")
        self._log.close()

    def note(self, text: str, level: Level = Level.NORMAL) -> None:
        if self._console is not None and level <= self.level:
            self._break_line()
            self._console.print(text)
        self._log.write(text)

    def warn(self, text: str) -> None:
        """Print a warning at every level."""
        self.note(f"warning: {text}", Level.QUIET)

    def open_log(self, comm: Intracomm, directory: Path, about: str) -> None:
        """Open the log in a run's directory, and write earlier messages to it; collective."""
        hosts = comm.gather(socket.gethostname())
        if hosts is None:  # not rank 0
            return
        self._log.open(directory)
        self._log.write(f"{about}; {counted(self._ranks, 'rank')} on {', '.join(sorted(set(hosts)))}")
        if self._log.fault:
            self.warn(self._log.fault)

    @contextmanager
    def phase(self, name: str, about: str = "", *, announced: bool = True) -> Iterator[None]:
        """Print a phase of a run within the context as one line: its name, each `detail`, and its time.

        Args:
            announced: whether a line begins with the name of the phase; else other lines have announced it.
        """
        begun = time.perf_counter()
        title = f"{name} {about}".rstrip()
        self._break_line()
        outer, self._phase = self._phase, _Phase(title, broken=not announced)
        if announced:
            self._log.write(f"{title} ...")
            if self._is_terminal:
                self._show(title)
            else:
                self._print(f"{title}:", end="")
        try:
            yield
            self._end_phase(self._phase, name, time.perf_counter() - begun)
        finally:
            self._break_line()
            self._phase = outer

    def detail(self, text: str) -> None:
        if self._phase is None:
            return
        self._log.write(f"  {text}")
        first, self._phase.details = not self._phase.details, [*self._phase.details, text]
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], description=f"{self._phase.title}: {text}")
        elif self._phase.broken and not self._is_terminal:
            self._print(f"  {text}")
        elif not self._is_terminal:
            self._print(f"{'' if first else ','} {text}", end="")

    def iteration(self, iteration: NewtonIteration) -> None:
        tangent = ", new tangent" if iteration.new_tangent else ""
        sizes = f"correction {iteration.correction:.3g} of {iteration.state:.3g}, residual {iteration.residual:.3g}"
        self.note(f"    iteration: {sizes}{tangent}", Level.VERBOSE)

    def _end_phase(self, phase: _Phase, name: str, seconds: float) -> None:
        text = f"{', '.join(phase.details)}; {seconds:.1f} s" if phase.details else f"{seconds:.1f} s"
        self._log.write(f"{phase.title}: {text}")
        if self._is_terminal:
            self.close()
        if phase.broken:
            self._print(f"  {name}: {seconds:.1f} s")
        elif self._is_terminal:
            self._print(f"{phase.title}: {text}")
        else:
            self._print(f"{';' if phase.details else ''} {seconds:.1f} s")
            phase.broken = True

    def _break_line(self) -> None:
        """End the incomplete line of a phase, so that other lines can follow."""
        if self._phase is not None and not self._phase.broken:
            self._phase.broken = not self._is_terminal
            if not self._is_terminal:
                self._print()

    def _print(self, text: str = "", end: str = "\n") -> None:
        if self._console is not None and self.level >= Level.NORMAL:
            self._console.print(text, end=end)

    @property
    def _is_terminal(self) -> bool:
        return self._console is not None and self._console.is_terminal and self.level >= Level.NORMAL

    def _show(self, title: str, total: float | None = None) -> None:
        if not self._is_terminal or self._bar is not None:
            return
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as LiveBar

        text = TextColumn("  {task.description}", markup=False)
        columns = (text, BarColumn(), TextColumn("{task.completed:.3f}" if total else ""), TimeElapsedColumn())
        self._bar = LiveBar(*columns, console=self._console, transient=True, refresh_per_second=2)
        self._bar.add_task(title, total=total)
        self._bar.start()

    def begin(self, job: Job, body: Body, unknowns: int, directory: Path, restart: Restart | None) -> None:
        """Print the problem, the directory of its results, and the checkpoint that it resumes from."""
        cells = sum(body.partition.cells)
        ranks = counted(self._ranks, "rank")
        self._directory = str(directory)
        kind = job.kind.removesuffix(" analysis")
        self.note(f"{job.job}: {kind}, {cells} cells, {unknowns} unknowns, {ranks}; results in {directory}")
        for line in on_demand("notes on rules of fibres")(body) if job.families else ():
            self.note(f"  {line}")
        if restart is not None:
            for complaint in restart.complaints:
                self.note(f"  not used: {complaint}")
            state = job.plan[restart.position.direction_index].job.state
            state_text = f" of state '{state}'" if state else ""
            self.note(f"  resumed from {restart.path} at load factor {restart.position.load:.6g}{state_text}")

    def state(self, job: Job, number: int) -> None:
        """Announce the state of the next solve, a number in the plan of the job; nothing without states."""
        solve = job.plan[number]
        if state := solve.job.state:
            start_name = job.rest if solve.start is None else job.plan[solve.start].job.state
            text = f"from it to {job.rest}" if solve.direction == "inverse" else f"from {start_name}"
            self.close()
            self.note(f"state {state}, {text}")

    def body(self, totals: Totals) -> None:
        """Print size, volume, mass and load of the meshed part, which reveal mistakes in units."""
        sides = " x ".join(readable(side, "m") for side in totals.size)
        parts = [sides, f"volume {readable(totals.volume, 'm^3')}"]
        if totals.mass is not None:
            parts.append(f"mass {readable(totals.mass, 'kg')}")
        if totals.load is not None:
            size = math.hypot(*totals.load)
            direction = ", ".join(f"{part / size:.3g}" for part in totals.load) if size else ""
            parts.append(f"resultant of the loads {readable(size, 'N')}{direction and f' along ({direction})'}")
        self.note(f"  meshed part: {', '.join(parts)}")
        for text in totals.warnings:
            self.warn(text)

    def begun(self, direction: Direction, linear: Used) -> None:
        self.close()
        self._direction, self._last = direction, time.perf_counter()
        self.note(f"{direction}:")
        self._set_up = "factorization" if linear.configuration == "direct" else "tangent"
        self.note(f"  {linear.configuration} linear solver: {linear.why}")
        if linear.note:
            self.note(f"  {linear.note}")
        self._show("load", total=1.0)

    def solved(self, event: SolveEvent) -> None:
        solve, now = event.solve, time.perf_counter()
        seconds, self._last = now - self._last, now
        effort = f"{counted(len(solve.iterations), 'iteration')}, {counted(solve.factorizations, self._set_up)}"
        if solve.linear_iterations:
            effort += f", {solve.linear_iterations} Krylov iterations"
        if solve.outcome.accepted:
            F = {"forward": "det F", "inverse": "det F^-1"}[self._direction]
            state = f"largest displacement {readable(event.largest_displacement, 'm', 4)}, {F} > {event.min_mesh_J:.4g}"
            distance = (
                ""
                if solve.position_residual is None
                else f" {readable(solve.position_residual, 'm')} from the given shape,"
            )
            self.note(f"  load {solve.load:.4g}: {effort},{distance} {state}, {seconds:.1f} s")
            if solve.bifurcation is not None:
                mode = ", ".join(f"{component:.2g}" for component in solve.mode)
                self.note(f"  other paths branch off at load {solve.bifurcation:.6g}, with displacement along ({mode})")
        else:
            self.note(f"  load {solve.load:.4g} not reached: {solve.outcome.text}; {effort}, {seconds:.1f} s")
        if self._bar is not None and solve.outcome.accepted:
            self._bar.update(self._bar.task_ids[0], completed=solve.load)

    def failing(self, lines: Sequence[str]) -> None:
        for line in lines:
            self.note(f"  {line}")

    def finish(self, statistics: Mapping[str, Any]) -> None:
        self.close()
        for line in report(statistics):
            self.note(line)
        if self.level == Level.QUIET:
            for line in short_report(statistics, self._directory):
                self.note(line, Level.QUIET)

    def close(self) -> None:
        """Remove the live bar from the terminal, and show the cursor."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


class SilentProgress(Progress):
    """Progress that prints nothing and keeps the statistics of a run, also of one that fails at its end."""

    def __init__(self, comm: Intracomm) -> None:
        super().__init__(comm, None)
        self.statistics: Mapping[str, Any] = {}

    def finish(self, statistics: Mapping[str, Any]) -> None:
        self.statistics = statistics

    def open_log(self, comm: Intracomm, directory: Path, about: str) -> None:
        """Write no log."""


@dataclass
class _Phase:
    """Line of a phase; ``broken``: the line was ended early, so that the time is printed in another one."""

    title: str
    broken: bool
    details: list[str] = field(default_factory=list)
