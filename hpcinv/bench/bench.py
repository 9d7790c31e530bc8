"""Starts runs that are measured: each in processes of its own, as a user starts it, and in turns with others."""

from __future__ import annotations

import json
import os
import resource
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml

from hpcinv.bench.bodies import JobData
from hpcinv.bench.runs import Run, events_in
from hpcinv.errors import OutputError, SolveError, SystemPartMissing


class Bench:
    """Starts runs, and keeps what they write in one directory.

    Args:
        note: told what is being run.
    """

    def __init__(self, directory: Path, note: Callable[[str], None]) -> None:
        self.directory, self.note = directory, note
        self._launcher, self._count = launcher(), 0

    def run(self, job: JobData, ranks: int = 1, *, log: bool = False) -> Run:
        """Run a job on this many ranks.

        Args:
            log: whether to read PETSc's log of all events.
        """
        self._count += 1
        where = self.directory / f"run-{self._count}"
        where.mkdir()
        file, events = where / "job.yaml", where / "events.csv"
        file.write_text(yaml.safe_dump(dict(job), sort_keys=False))
        environment = dict(os.environ)
        if log:
            asked = f"{environment.get('PETSC_OPTIONS', '')} -log_view :{events}:ascii_csv"
            environment["PETSC_OPTIONS"] = asked.strip()
        command = [*self._launcher, "-n", str(ranks), sys.executable, "-m", "hpcinv", "run", str(file)]
        cpu, begun = _cpu(), time.perf_counter()
        done = subprocess.run(
            [*command, "--output", str(where / "results"), "--ranks", str(ranks)],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        seconds, used = time.perf_counter() - begun, _cpu() - cpu
        summary = where / "results" / "summary.json"
        found = json.loads(summary.read_text(encoding="utf-8")) if summary.exists() else None
        ending = f"exit code {done.returncode}: {done.stderr.strip()[-1000:]}"
        return Run(seconds, used, found, events_in(events), ending)

    def must_run(self, name: str, job: JobData, ranks: int = 1, *, log: bool = False) -> Run:
        """The same; raises ``SolveError`` if it is not solved."""
        self.note(name)
        found = self.run(job, ranks, log=log)
        if not found.solved:
            raise SolveError(f"{name}: {found.summary['status'] if found.summary else found.ending}")
        return found

    def results(self) -> Path:
        """Where the last run has left its results."""
        return self.directory / f"run-{self._count}" / "results"

    def in_turns(self, jobs: Mapping[str, tuple[JobData, int]], repeat: int) -> dict[str, list[Run]]:
        """Runs of each job and number of ranks, one after the other in rounds.

        A machine that slows down is unfair to none then. The kernels are compiled before the first round.
        """
        for name, (job, _) in jobs.items():
            self.compile(name, job)
        runs: dict[str, list[Run]] = {name: [] for name in jobs}
        for number in range(1, repeat + 1):
            for name, (job, ranks) in jobs.items():
                runs[name].append(self.must_run(f"{name}, {number} of {repeat}", job, ranks))
        return runs

    def compile(self, name: str, job: JobData) -> None:
        """See that runs of this job find their kernels compiled."""
        self.note(f"{name}: compiling")
        self._command("hpcinv", "compile", self._written(job))

    def partitioned(self, job: JobData, parts: int) -> dict[str, Any]:
        """The mesh of a job, partitioned beforehand."""
        file = self.directory / f"parts-{parts}.bp"
        self._command("hpcinv", "mesh", "partition", self._written(job), file, "--parts", parts)
        return {"file": str(file)}

    def bandwidth(self, ranks: int) -> float:
        """Bytes per second that these ranks together read and write."""
        return float(self._command("hpcinv.bench.stream", ranks=ranks))

    def start(self) -> float:
        """Seconds of processor time until a rank is ready to read its job."""
        seconds = []
        for _ in range(3):
            cpu = _cpu()
            subprocess.run([sys.executable, "-c", "import hpcinv.job.job, hpcinv.driver"], check=True)
            seconds.append(_cpu() - cpu)
        return min(seconds)

    def _written(self, job: JobData) -> Path:
        file = self.directory / "job.yaml"
        file.write_text(yaml.safe_dump(dict(job), sort_keys=False))
        return file

    def _command(self, module: str, *arguments: object, ranks: int = 1) -> str:
        """What it prints."""
        command = [*self._launcher, "-n", str(ranks), sys.executable, "-m", module, *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SolveError(f"{' '.join([module, *map(str, arguments[:1])])}: {done.stderr.strip()[-1000:]}")
        return done.stdout


def launcher() -> list[str]:
    """What starts ranks: HPCINV_LAUNCHER, or the mpirun that belongs to this Python.

    Raises:
        OutputError: this process is itself one of several ranks.
        SystemPartMissing: there is no such program.
    """
    if int(os.environ.get("PMI_SIZE", "1")) > 1:
        raise OutputError("bench starts the ranks itself", "Start it once, without mpirun.")
    beside = Path(sys.executable).parent / "mpirun"
    found = shlex.split(os.environ.get("HPCINV_LAUNCHER", "")) or [str(beside) if beside.exists() else "mpirun"]
    if shutil.which(found[0]) is None:
        raise SystemPartMissing(f"no launcher '{found[0]}'", "Set HPCINV_LAUNCHER, such as to 'srun --mpi=pmi2'.")
    return found


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
