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
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TextIO

from hpcinv.errors import HpcinvError
from hpcinv.job.sections import REACTIONS, is_of_nodes
from hpcinv.model.fibre_directions import notes_on_rules
from hpcinv.output.run_log import RunLog
from hpcinv.quantity.units import readable
from hpcinv.quantity.written_units import as_shown
from hpcinv.reports.shape_error import shape_error
from hpcinv.reports.wording import remedy
from hpcinv.solver.observer import Observer

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm
    from rich.console import Console
    from rich.progress import Progress as LiveBar

    from hpcinv.effects import Direction
    from hpcinv.job.job import Job
    from hpcinv.mesh import Body
    from hpcinv.output.checkpoint import Restart
    from hpcinv.results.totals import Totals
    from hpcinv.solver.linear.selection import Used
    from hpcinv.solver.newton import NewtonIteration
    from hpcinv.solver.observer import SolveEvent

_ERRORS = {
    "round_trip": "round trip: closes to {max} ({relative:.1g} of the body's length)",
    "expected_shape": "recovered shape: {max} from the expected one ({relative:.1g} of its length)",
    "expected_surface": "recovered surface: up to {max} from the expected one, rms {rms}, 95 % within"
    " {quantile_95}, overlap (Dice) {dice:.3f}",
}


_LENGTHS = ("max", "rms", "quantile_95")  # in _ERRORS
_SHOWN = 0.05  # s; times of checks above it are printed


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
        self._log.write(f"{about}; {_count(self._ranks, 'rank')} on {', '.join(sorted(set(hosts)))}")
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
        ranks = _count(self._ranks, "rank")
        self._directory = str(directory)
        kind = job.kind.removesuffix(" analysis")
        self.note(f"{job.job}: {kind}, {cells} cells, {unknowns} unknowns, {ranks}; results in {directory}")
        for line in notes_on_rules(body):
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
        effort = f"{_count(len(solve.iterations), 'iteration')}, {_count(solve.factorizations, self._set_up)}"
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
            for line in _short_report(statistics, self._directory):
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


def _contact(contact: Mapping[str, Any], symbols: Mapping[str, str]) -> str:
    penetration = f"penetration at most {as_shown(contact['penetration'], 'm', symbols)}"
    if contact["tolerance"]:
        penetration += f" (tolerated: {as_shown(contact['tolerance'], 'm', symbols)})"
    return (
        f"  {contact['effect']} contact on '{contact['region']}': force"
        f" {as_shown(contact['force'], 'N', symbols)}, area {_number(contact['area'])} m², largest pressure"
        f" {as_shown(contact['largest_pressure'], 'Pa', symbols)}, {penetration};"
        f" {contact['assumption']}"
    )


def _cavity(cavity: Mapping[str, Any], symbols: Mapping[str, str]) -> str:
    pressure = as_shown(cavity["pressure"], "Pa", symbols)
    volume, unloaded = (as_shown(cavity[key], "m^3", symbols) for key in ("volume", "unloaded_volume"))
    return f"  cavity '{cavity['name']}': pressure {pressure}, volume {volume}, unloaded {unloaded}"


def _remote_load(load: Mapping[str, Any], symbols: Mapping[str, str]) -> str:
    motion = load["motion"]
    moved = as_shown(motion["move"], "m", symbols)
    axis = ", ".join(_number(c) for c in motion["axis"])
    turned = f"turned by {math.degrees(motion['rotate']):.5g}° about ({axis})"
    return f"  remote load on '{load['region']}': moved by {moved}, {turned}"


def _short_report(statistics: Mapping[str, Any], directory: str) -> list[str]:
    """Return the report of a quiet run: lines of the certificate that do not pass, and the outcome."""
    certificate, seconds = statistics["certificate"], statistics["timings"]["total"]
    certificate_lines = _certificate(certificate, statistics.get("units", {}))[1:]
    open_questions = [line for line in certificate_lines if line.lstrip().startswith(("warning", "fail"))]
    where = f"; results in {directory}" if directory else ""
    return [*open_questions, f"{statistics['status']}, certificate {certificate['verdict']}, {seconds:.1f} s{where}"]


def report(statistics: Mapping[str, Any]) -> list[str]:
    """Return the report of a run: lines of text on its statistics."""
    timings, solutions, symbols = statistics["timings"], statistics["solutions"], statistics.get("units", {})
    total = sum(solution["factorizations"] for solution in solutions)
    lines = [f"{statistics['status']}, {_count(total, 'factorization')}, {timings['total']:.1f} s"]
    slowest = sorted(((p["max"], phase) for phase, p in timings["phases"].items()), reverse=True)
    lines.append("  seconds: " + ", ".join(f"{phase} {seconds:.1f}" for seconds, phase in slowest if seconds >= _SHOWN))
    lines.append(f"  outside kernels, PETSc and MPI: {100 * timings['overhead']:.0f} %")
    memory = statistics["peak_memory"]
    most = max(memory["phases"], key=lambda phase: memory["phases"][phase]["max"])
    lines.append(f"  memory: {max(memory['ranks']) / 1e6:.0f} MB on the fullest rank; most in {most}")
    for solution in solutions:
        title = solution.get("state", solution["direction"])
        if solution["linear"] and solution["linear"]["fallback"]:
            lines.append(f"  {title}: {solution['linear']['fallback']}")
        if coarse := solution.get("coarse"):
            fate = f"not used: {coarse['unused']}" if coarse["unused"] else "the path was followed there"
            effort = f"{coarse['unknowns']} unknowns, {_count(coarse['factorizations'], 'factorization')}"
            lines.append(f"  {title}: on coarser cells {effort}; {fate}")
        lines.append(
            f"  {title}: J from {_number(solution['J']['min'])} to {_number(solution['J']['max'])}, "
            f"strain energy {_number(solution['strain_energy'])} J"
        )
        lines += (_contact(contact, symbols) for contact in solution["contacts"])
        lines += (_cavity(cavity, symbols) for cavity in solution.get("cavities", ()))
        lines += (_remote_load(load, symbols) for load in solution.get("remote_loads", ()))
    if unused := statistics["unused_petsc_options"]:
        lines.append(f"  solver.petsc: nothing asked for {', '.join(unused)}: misspelt, or without effect here")
    lines += _certificate(statistics["certificate"], symbols)
    if (error := shape_error(statistics)) is not None:
        lines.append(f"shape: estimated error {error.text}")
    estimated = statistics["certificate"]["estimate"] or {"quantities": {}, "without_geometry": ""}
    bounds = (statistics.get("accuracy") or {"bounds": {}})["bounds"]
    omission = ", without the error of the geometry" if estimated.get("without_geometry") else ""
    singular = estimated.get("singular")
    is_doubted, unreliable = bool(singular and not singular["reliable"]), estimated.get("unreliable", ())
    slopes = statistics["sensitivities"] or {"quantities": {}}
    surface_deviations = (statistics.get("surface_errors") or {}).get("quantities", {})
    reactions, node_reductions = _reactions(statistics), _node_reductions(statistics)
    units = statistics.get("quantity_units", {})
    for name, value in statistics["quantities"].items():
        notes = []
        unit = units.get(name, "m" if isinstance(value, list) else "")
        text = partial(as_shown, unit=unit, symbols=symbols)
        if (spread := surface_deviations.get(name)) is not None:
            notes.append(f"± {text(spread, digits=2)} by errors of the surface")
        if name in bounds:  # only one error of a quantity is printed
            notes.append(f"error at most {text(bounds[name], digits=3)}{omission}")
        elif name in estimated["quantities"]:
            doubt = ", not reliable here" if is_doubted or name in unreliable else ""
            notes.append(f"estimated error {text(estimated['quantities'][name], digits=2)}{omission}{doubt}")
        elif name in reactions and statistics["certificate"]["estimate"] is not None:
            notes.append("no error estimate for reactions")
        if (deviation := slopes["quantities"].get(name, {"sd": None})["sd"]) is not None:
            notes.append(f"standard deviation {text(deviation, digits=2)}")
        elif name in reactions and statistics["sensitivities"] is not None:
            notes.append("no sensitivities of reactions")
        lines.append(
            f"{name}: {text(value)}{f' ({", ".join(notes)})' if notes else ''}"
            + (f", {node_reductions[name]} of the nodes" if name in node_reductions else "")
        )
    lines += _sensitivities(statistics["sensitivities"], symbols)
    lines += [
        _ERRORS["expected_surface" if "dice" in sizes else name].format(
            **sizes | {key: as_shown(sizes[key], "m", symbols, 3) for key in _LENGTHS if key in sizes}
        )
        for name in ("round_trip", "expected_shape")
        if (sizes := statistics["errors"].get(name))
    ]
    return lines


def _certificate(certificate: Mapping[str, Any], symbols: Mapping[str, str]) -> list[str]:
    lines = [f"certificate: {certificate['verdict']}"]
    for line in certificate["lines"]:
        value_text = "" if line["value"] is None else f" {as_shown(line['value'], line['unit'], symbols, 3)}"
        note = f" ({line['note']})" if line["note"] else ""
        seconds = f", {line['seconds']:.1f} s" if (line["seconds"] or 0.0) >= _SHOWN else ""
        state = f"{line['state']}: " if "state" in line else ""
        lines.append(f"  {line['verdict']}: {state}{line['name']}{value_text}{note}{seconds}")
        if text := remedy(line):
            lines.append(f"    {text}")
    return lines


def _sensitivities(sensitivities: Mapping[str, Any] | None, symbols: Mapping[str, str]) -> list[str]:
    """Return lines on the derivatives by each parameter, and on the standard deviation of the shape."""
    if sensitivities is None:
        return []
    lines, shapes = ["per SI unit of"], sensitivities.get("shapes") or {"": sensitivities["shape"]}
    for key in sensitivities["parameters"]:
        slopes = [
            f"{name} {_value(entry['slopes'][key], digits=4)}" for name, entry in sensitivities["quantities"].items()
        ]
        for state, shape in shapes.items():
            slopes.append(f"{_shape(state)} up to {_number(shape['largest'][key], 4)} m")
        lines.append(f"  {key}: {', '.join(slopes)}")
    for state, shape in shapes.items():
        if shape["sd"] is not None:
            most = f"up to {as_shown(shape['sd'], 'm', symbols, 2)}, at {as_shown(shape['sd_at'], 'm', symbols, 4)}"
            lines.append(f"{_shape(state)}: standard deviation {most}")
    return lines


def _shape(state: str) -> str:
    return f"shape '{state}'" if state else "shape"


def _reactions(statistics: Mapping[str, Any]) -> dict[str, str]:
    """Return the units of the quantities that are reactions, by name."""
    sources = {q["name"]: q["of"].strip() for q in statistics.get("job", {}).get("quantities", ())}
    return {name: REACTIONS[source] for name, source in sources.items() if source in REACTIONS}


def _node_reductions(statistics: Mapping[str, Any]) -> dict[str, str]:
    """Return the reductions of the quantities that are means of nodes, by name."""
    job = statistics.get("job", {})
    return {q["name"]: q["reduce"] for q in job.get("quantities", ()) if is_of_nodes(q, job.get("let", {}))}


def _value(value: float | list[float | None] | None, digits: int = 6, unit: str = "m") -> str:
    """Return a number, or a vector with its unit, as text."""
    if isinstance(value, list):
        return f"({', '.join(_number(v, digits) for v in value)}) {unit}"
    return _number(value, digits)


def _number(value: float | None, digits: int = 6) -> str:
    return "not finite" if value is None else f"{value:.{digits}g}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
