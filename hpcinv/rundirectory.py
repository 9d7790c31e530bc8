"""The directory of one run: the job as it was run, checkpoints, and results."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from hpcinv.errors import OutputError
from hpcinv.job import Job, load, parse
from hpcinv.loading import read_yaml

_ORIGIN = "origin.json"


@dataclass(frozen=True)
class RunDirectory:
    """``job.yaml`` as run, ``origin.json`` (where from), ``checkpoints/``, ``fields/``, ``shape.*``, ``summary.*``."""

    path: Path

    @property
    def checkpoints(self) -> Path:
        return self.path / "checkpoints"

    @property
    def is_finished(self) -> bool:
        try:
            status = json.loads((self.path / "summary.json").read_text())["status"]
        except (OSError, ValueError, KeyError):
            return False
        return bool(status == "converged")

    def create(self, job: Job, *, overwrite: bool) -> None:
        """Make the directory and put the job in it.

        Raises:
            OutputError: there are other results, or it cannot be written.
        """
        if self._is_taken() and not overwrite:
            raise OutputError(
                f"{self.path}: holds the results of another run",
                "Choose another place with --output, go on with it by 'resume', or give --overwrite.",
            )
        try:
            if self._is_taken():
                shutil.rmtree(self.path)
            self.path.mkdir(parents=True, exist_ok=True)
            if job.path is not None:
                shutil.copyfile(job.path, self.path / "job.yaml")
                (self.path / _ORIGIN).write_text(json.dumps({"job": str(job.path.resolve())}))
        except OSError as exc:
            raise OutputError(f"{self.path}: cannot be written: {exc.strerror}", "Choose another --output.") from exc

    def job(self, changed: Path | None) -> Job:
        """The job to resume: the one that was run, or a ``changed`` file.

        Raises:
            OutputError: this is no directory of a run.
            JobError: the job is not valid (any more).
        """
        try:
            origin = Path(json.loads((self.path / _ORIGIN).read_text())["job"])
        except (OSError, ValueError, KeyError) as exc:
            raise OutputError(
                f"{self.path}: is not the directory of a run",
                "Give 'resume' the directory that 'run' named when it began, such as results/pdms-beam.",
            ) from exc
        # Relative paths in the job still start from where the job file was.
        return load(changed) if changed else parse(read_yaml(self.path / "job.yaml"), origin)

    def _is_taken(self) -> bool:
        return self.path.exists() and (not self.path.is_dir() or any(self.path.iterdir()))


def choose(output: Path | None, job: Job) -> RunDirectory:
    """The directory asked for, or the first free one of ``results/JOB``, ``results/JOB-2``, …"""
    if output is not None:
        return RunDirectory(output)
    base = Path("results")
    number = 1
    while (path := base / (job.job if number == 1 else f"{job.job}-{number}")).exists():
        number += 1
    return RunDirectory(path)


def relative(path: Path) -> str:
    """A path as short as the working directory allows."""
    return os.path.relpath(path)
