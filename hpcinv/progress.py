"""What a run says while it goes on: one line for each step on rank 0, a live bar on a terminal, a report at the end."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TextIO

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm
    from rich.console import Console
    from rich.progress import Progress as LiveBar

    from hpcinv.checkpoint import Restart
    from hpcinv.equilibrium import Solve
    from hpcinv.job import Job
    from hpcinv.linear.choice import Used
    from hpcinv.mesh import Body

_ERRORS = {
    "round_trip": "round trip: closes to {max:.3g} m ({relative:.1g} of the body's length)",
    "expected_shape": "recovered shape: {max:.3g} m from the expected one ({relative:.1g} of its length)",
}


class Progress:
    """Messages of a run; silent without a stream, and on every rank but 0.

    Use it as a context, which takes the live bar off the terminal whatever happens.
    """

    def __init__(self, comm: Intracomm, stream: TextIO | None) -> None:
        self._console: Console | None = None
        if stream is not None and comm.rank == 0:
            from hpcinv.console import RunConsole  # a tenth of the files of a start, which other ranks need not read

            self._console = RunConsole(file=stream, highlight=False, markup=False, soft_wrap=True)
        self._ranks = comm.size
        self._bar: LiveBar | None = None
        self._direction = ""
        self._last = time.perf_counter()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def note(self, text: str) -> None:
        """One line of text."""
        if self._console is not None:
            self._console.print(text)

    def begin(self, job: Job, body: Body, unknowns: int, directory: Path, restart: Restart | None) -> None:
        """What is about to be solved, and where results go."""
        cells = sum(body.partition.cells)
        ranks = f"{self._ranks} rank{'s' if self._ranks > 1 else ''}"
        self.note(f"{job.job}: {job.analysis}, {cells} cells, {unknowns} unknowns, {ranks}; results in {directory}")
        if restart is not None:
            for complaint in restart.complaints:
                self.note(f"  not used: {complaint}")
            self.note(f"  resumed from {restart.path} at load factor {restart.position.load:.6g}")

    def leg(self, direction: str, linear: Used) -> None:
        """A direction begins, with a linear solver."""
        self.close()
        self._direction, self._last = direction, time.perf_counter()
        self.note(f"{direction}:")
        self.note(f"  {linear.preset} linear solver: {linear.why}")
        if self._console is not None and self._console.is_terminal:
            from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as LiveBar

            columns = TextColumn("  load"), BarColumn(), TextColumn("{task.completed:.3f}"), TimeElapsedColumn()
            self._bar = LiveBar(*columns, console=self._console, transient=True, refresh_per_second=2)
            self._bar.add_task(direction, total=1.0)
            self._bar.start()

    def solve(self, solve: Solve, largest_displacement: float, min_mesh_J: float) -> None:
        """A step was solved, or not: the state is then that of the last one that was."""
        now = time.perf_counter()
        seconds, self._last = now - self._last, now
        effort = f"{_count(len(solve.iterations), 'iteration')}, {_count(solve.factorizations, 'factorization')}"
        if solve.linear_iterations:
            effort = f"{effort.replace('factorization', 'tangent')}, {solve.linear_iterations} Krylov iterations"
        if solve.outcome.accepted:
            F = {"forward": "det F", "inverse": "det F^-1"}[self._direction]
            state = f"largest displacement {largest_displacement:.4g} m, {F} > {min_mesh_J:.4g}"
            gap = "" if solve.gap is None else f" {solve.gap:.3g} m from the given shape,"
            self.note(f"  load {solve.load:.4g}: {effort},{gap} {state}, {seconds:.1f} s")
        else:
            self.note(f"  load {solve.load:.4g} not reached: {solve.outcome.text}; {effort}, {seconds:.1f} s")
        if self._bar is not None and solve.outcome.accepted:
            self._bar.update(self._bar.task_ids[0], completed=solve.load)

    def finish(self, statistics: Mapping[str, Any]) -> None:
        """How it ended; how far it is from what was expected stands last."""
        self.close()
        for line in report(statistics):
            self.note(line)

    def close(self) -> None:
        """Take the live bar off the terminal, and give that its cursor back."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


class Listener(Progress):
    """Says nothing, and hears the statistics of a run, also of one that fails in the end."""

    def __init__(self, comm: Intracomm) -> None:
        super().__init__(comm, None)
        self.statistics: Mapping[str, Any] = {}

    def finish(self, statistics: Mapping[str, Any]) -> None:
        self.statistics = statistics


def report(statistics: Mapping[str, Any]) -> list[str]:
    """Lines of text on the statistics of a run."""
    timings, legs = statistics["timings"], statistics["legs"]
    total = sum(leg["factorizations"] for leg in legs)
    lines = [f"{statistics['status']}, {_count(total, 'factorization')}, {timings['total']:.1f} s"]
    slowest = sorted(((p["max"], phase) for phase, p in timings["phases"].items()), reverse=True)
    lines.append("  seconds: " + ", ".join(f"{phase} {seconds:.1f}" for seconds, phase in slowest if seconds >= 0.05))
    lines.append(f"  outside kernels, PETSc and MPI: {100 * timings['overhead']:.0f} %")
    memory = statistics["peak_memory"]
    most = max(memory["phases"], key=lambda phase: memory["phases"][phase]["max"])
    lines.append(f"  memory: {max(memory['ranks']) / 1e6:.0f} MB on the fullest rank; most in {most}")
    for leg in legs:
        if leg["linear"] and leg["linear"]["fallback"]:
            lines.append(f"  {leg['direction']}: {leg['linear']['fallback']}")
        lines.append(
            f"  {leg['direction']}: J from {_number(leg['J']['min'])} to {_number(leg['J']['max'])}, "
            f"strain energy {_number(leg['strain_energy'])} J"
        )
    if unused := statistics["unused_petsc_options"]:
        lines.append(f"  solver.petsc: nothing asked for {', '.join(unused)}: misspelt, or without effect here")
    lines += _certificate(statistics["certificate"])
    estimated = (statistics["certificate"]["estimate"] or {"quantities": {}})["quantities"]
    slopes = statistics["sensitivities"] or {"quantities": {}}
    for name, value in statistics["quantities"].items():
        notes = [f"estimated error {_value(estimated[name], digits=2)}"] if name in estimated else []
        if (deviation := slopes["quantities"].get(name, {"sd": None})["sd"]) is not None:
            notes.append(f"standard deviation {_value(deviation, digits=2)}")
        lines.append(f"{name}: {_value(value)}{f' ({", ".join(notes)})' if notes else ''}")
    lines += _sensitivities(statistics["sensitivities"])
    lines += [
        text.format(**statistics["errors"][name]) for name, text in _ERRORS.items() if name in statistics["errors"]
    ]
    return lines


def _certificate(certificate: Mapping[str, Any]) -> list[str]:
    """The verdict, and each finding under it."""
    lines = [f"certificate: {certificate['verdict']}"]
    for line in certificate["lines"]:
        found = "" if line["value"] is None else f" {_number(line['value'], 3)}{line['unit'] and ' ' + line['unit']}"
        note = f" ({line['note']})" if line["note"] else ""
        lines.append(f"  {line['verdict']}: {line['name']}{found}{note}")
    return lines


def _sensitivities(found: Mapping[str, Any] | None) -> list[str]:
    """What changes with each parameter, and how uncertain the shape is."""
    if found is None:
        return []
    lines = ["per SI unit of"]
    for key in found["parameters"]:
        slopes = [f"{name} {_value(of['slopes'][key], digits=4)}" for name, of in found["quantities"].items()]
        lines.append(f"  {key}: {', '.join([*slopes, f'shape up to {_number(found["shape"]["largest"][key], 4)} m'])}")
    shape = found["shape"]
    if shape["sd"] is not None:
        lines.append(f"shape: standard deviation up to {_number(shape['sd'], 2)} m, at {_value(shape['sd_at'], 4)}")
    return lines


def _value(value: float | list[float | None] | None, digits: int = 6) -> str:
    """A number, or a displacement."""
    if isinstance(value, list):
        return f"({', '.join(_number(v, digits) for v in value)}) m"
    return _number(value, digits)


def _number(value: float | None, digits: int = 6) -> str:
    return "not finite" if value is None else f"{value:.{digits}g}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
