"""Measured runs of jobs, each started from the command line, with times and memory.

``mpirun -n 2 python benchmarks/bench_runs.py`` prints the number of ranks, the seconds until they were ready, and the
bytes per second that all ranks together read and write.
"""

import json
import os
import shlex
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from hpcinv.base.parallel.timings import SOLVER
from hpcinv.base.quantity.keys import look_up
from hpcinv.errors import OutputError, SolveError, SystemPartMissing
from hpcinv.output.console import table_console, table_of_numbers

type JobData = Mapping[str, Any]

WITHOUT_CERTIFICATE = "off"
_STREAM_LENGTH, _STREAM_REPEATS = 10_000_000, 10  # larger than any cache


@dataclass(frozen=True)
class MeasuredRun:
    """One measured run.

    Attributes:
        summary: the run's summary.json, ``None`` if it was not written.
        ending: the exit code and the end of stderr.
    """

    seconds: float
    summary: Mapping[str, Any] | None
    ending: str

    @property
    def solved(self) -> bool:
        return self.summary is not None and self.summary["status"] == "converged"

    @property
    def data(self) -> Mapping[str, Any]:
        """The summary of a solved run."""
        if self.summary is None:
            raise SolveError(self.ending)
        return self.summary

    @property
    def unknowns(self) -> int:
        return int(self.data["mesh"]["unknowns"])

    def count(self, name: str) -> int:
        """Return ``factorizations``, ``newton_iterations`` or ``linear.iterations``, summed over solutions."""
        return int(look_up(self.data, f"solutions[].{name}") or 0)

    @property
    def phases(self) -> dict[str, float]:
        """Seconds by phase, on the rank that took longest."""
        return {name: float(spread["max"]) for name, spread in self.data["timings"]["phases"].items()}

    @property
    def solver(self) -> float:
        """Seconds of the phases in `SOLVER`."""
        return sum(self.phases.get(name, 0.0) for name in SOLVER)

    @property
    def memory(self) -> Sequence[int]:
        return [int(size) for size in self.data["peak_memory"]["ranks"]]


class Bench:
    """Starts runs whose files are written to one directory."""

    def __init__(self, directory: Path, note: Callable[[str], None]) -> None:
        self.directory, self.note = directory, note
        self._launcher, self._count = _launcher(), 0

    @property
    def results(self) -> Path:
        """The output directory of the last run."""
        return self.directory / f"run-{self._count}" / "results"

    def run(self, name: str, job: JobData, ranks: int = 1) -> MeasuredRun:
        self.note(name)
        self._count += 1
        self.results.parent.mkdir()
        file = self.results.parent / "job.yaml"
        file.write_text(yaml.safe_dump(dict(job), sort_keys=False), encoding="utf-8")
        begun = time.perf_counter()
        done = self._start(("hpcinv", "run", file, "--output", self.results, "--ranks", ranks), ranks)
        seconds, summary = time.perf_counter() - begun, self.results / "summary.json"
        content = json.loads(summary.read_text(encoding="utf-8")) if summary.exists() else None
        return MeasuredRun(seconds, content, f"exit code {done.returncode}: {done.stderr[-1000:]}")

    def must_run(self, name: str, job: JobData, ranks: int = 1) -> MeasuredRun:
        """Run a job as `run` does; raises ``SolveError`` if it is not solved."""
        measured = self.run(name, job, ranks)
        if not measured.solved:
            raise SolveError(f"{name}: {measured.summary['status'] if measured.summary else measured.ending}")
        return measured

    def alternating(self, jobs: Mapping[str, tuple[JobData, int]], repeat: int) -> dict[str, list[MeasuredRun]]:
        """Run each job in turn, ``repeat`` times, so that a change of the machine's speed affects all alike."""
        runs: dict[str, list[MeasuredRun]] = {name: [] for name in jobs}
        for number in range(1, repeat + 1):
            for name, (job, ranks) in jobs.items():
                runs[name].append(self.must_run(f"{name}, {number} of {repeat}", job, ranks))
        return runs

    def output(self, program: str, *arguments: object, ranks: int = 1) -> str:
        """Return the standard output of a Python file, or of a module; raises ``SolveError`` if it fails."""
        module = (program, *arguments)
        done = self._start(module, ranks)
        if done.returncode:
            raise SolveError(f"{' '.join(map(str, module))}: {done.stderr[-1000:]}")
        return done.stdout

    def _start(self, arguments: Sequence[object], ranks: int) -> subprocess.CompletedProcess[str]:
        program = [] if str(arguments[0]).endswith(".py") else ["-m"]
        command = [*self._launcher, "-n", str(ranks), sys.executable, *program, *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, check=False)


@dataclass(frozen=True)
class Findings:
    """A table with its title, notes below it, and all figures as data (s, bytes)."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()
    data: Mapping[str, Any] = field(default_factory=dict)

    def show(self) -> None:
        """Print the table; without styles to a file or a pipe."""
        console = table_console(160)
        console.print(self.title, style="bold")
        table = table_of_numbers(*self.columns)
        for row in self.rows:
            table.add_row(*row)
        console.print(table)
        for note in self.notes:
            console.print(note)
        console.print()


def median(runs: Sequence[MeasuredRun], figure: Callable[[MeasuredRun], float]) -> float:
    return statistics.median(map(figure, runs))


def _launcher() -> list[str]:
    """Return the command that starts ranks: HPCINV_LAUNCHER, or the mpirun next to this Python."""
    if int(os.environ.get("PMI_SIZE", "1")) > 1:
        raise OutputError("bench starts the ranks itself", "Start it once, without mpirun.")
    mpirun = Path(sys.executable).parent / "mpirun"
    command = shlex.split(os.environ.get("HPCINV_LAUNCHER", "")) or [str(mpirun) if mpirun.exists() else "mpirun"]
    if shutil.which(command[0]) is None:
        raise SystemPartMissing(f"no launcher '{command[0]}'", "Set HPCINV_LAUNCHER, such as to 'srun --mpi=pmi2'.")
    return command


def _probe() -> None:
    """Print ranks, seconds of the imports and bytes per second, by the sum of two vectors of STREAM (McCalpin, IEEE
    TCCA Newsletter, 19–25, December 1995)."""
    begun = time.perf_counter()

    # isort: split
    import numpy as np

    from hpcinv.base.parallel.runtime import MPI

    comm = MPI.COMM_WORLD
    imported = comm.allreduce(time.perf_counter() - begun, op=MPI.MAX)
    a, b, c = (np.ones(_STREAM_LENGTH) for _ in range(3))
    seconds = []
    for _ in range(_STREAM_REPEATS):
        comm.Barrier()
        begun = MPI.Wtime()
        np.add(a, b, out=c)
        seconds.append(comm.allreduce(MPI.Wtime() - begun, op=MPI.MAX))
    if comm.rank == 0:
        content = {"ranks": comm.size, "imports": imported, "bandwidth": comm.size * 3 * a.nbytes / min(seconds)}
        print(json.dumps(content))


if __name__ == "__main__":
    _probe()
