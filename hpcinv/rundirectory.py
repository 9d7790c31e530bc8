"""The directory of one run: the job as it was run, checkpoints, and results."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from hpcinv.errors import JobError, OutputError
from hpcinv.filenames import check_output
from hpcinv.job import Job, load, parse
from hpcinv.loading import read_yaml

_JOB, _ORIGIN = "job.yaml", "origin.json"
_CONTENT = (_JOB, _ORIGIN, "checkpoints", "fields", "shape.*", "summary.*", "run.log", ".*.partial")


@dataclass(frozen=True)
class RunDirectory:
    """``job.yaml`` as run, ``origin.json`` (where from), ``checkpoints/``, ``fields/``, ``shape.*``, ``summary.*``.

    Attributes:
        text: what stands in ``job.yaml``; left out, what is in the file that the job was read from.
    """

    path: Path
    text: str | None = None

    @property
    def checkpoints(self) -> Path:
        return self.path / "checkpoints"

    @property
    def is_finished(self) -> bool:
        try:
            status = json.loads((self.path / "summary.json").read_text())["status"]
        except (OSError, ValueError, KeyError, TypeError):
            return False
        return bool(status == "converged")

    def check_free(self, *, overwrite: bool) -> None:
        """Raise ``OutputError`` if a run cannot have this directory for itself; nothing is touched."""
        check_output(self.path)
        if self.path.exists() and not self.path.is_dir():
            raise OutputError(f"{self.path}: is a file", "Choose another --output.")
        if not self.path.is_dir() or not any(self.path.iterdir()):
            return
        if not (self.path / _ORIGIN).exists():
            raise OutputError(f"{self.path}: holds files that are not of a run", "Choose another --output.")
        if not overwrite:
            raise OutputError(
                f"{self.path}: holds the results of another run",
                "Choose another place with --output, go on with it by 'resume', or give --overwrite.",
            )

    def create(self, job: Job, *, overwrite: bool) -> None:
        """Make the directory and put the job in it; what another run left there goes, other files stay.

        Raises:
            OutputError: there are other results, or it cannot be written.
        """
        self.check_free(overwrite=overwrite)
        try:
            text = self._text(job)  # first: its file may be among what goes
            for old in (p for pattern in _CONTENT for p in self.path.glob(pattern)):
                shutil.rmtree(old) if old.is_dir() else old.unlink()
            self.path.mkdir(parents=True, exist_ok=True)
            with (self.path / _ORIGIN).open("x") as file:  # of two runs that start together one gets it
                json.dump(_origin_of(job), file)
            if text is not None:
                (self.path / _JOB).write_text(text)
        except FileExistsError as exc:
            raise OutputError(f"{self.path}: another run has just taken it", "Choose another --output.") from exc
        except OSError as exc:
            raise OutputError(f"{self.path}: cannot be written: {exc.strerror}", "Choose another --output.") from exc

    def change(self, job: Job) -> None:
        """Put a changed job in place of the one that was run, for the next resume.

        Raises:
            OutputError: it cannot be written.
        """
        if job.path is None:
            return
        try:
            for name, text in {
                _JOB: self._text(job) or "",
                _ORIGIN: json.dumps(_origin_of(job)),
            }.items():
                partial = self.path / f".{name}.partial"
                partial.write_text(text)
                partial.replace(self.path / name)
        except OSError as exc:
            raise OutputError(f"{self.path}: cannot be written: {exc.strerror}") from exc

    def _text(self, job: Job) -> str | None:
        if self.text is not None or job.path is None:
            return self.text
        with contextlib.suppress(JobError):  # there is no file of a job that was made in Python
            if read_yaml(job.path) == job.data:
                return job.path.read_text(encoding="utf-8")
        return yaml.safe_dump(_plain(job.data), sort_keys=False, allow_unicode=True)

    def job(self, changed: Path | None) -> Job:
        """The job to resume: the one that was run, or a ``changed`` file.

        Raises:
            OutputError: this is no directory of a run.
            JobError: the job is not valid (any more).
        """
        try:
            content = json.loads((self.path / _ORIGIN).read_text())
            origin, untrusted = content["job"], bool(content.get("untrusted", False))
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as exc:
            raise OutputError(
                f"{self.path}: is not the directory of a run",
                "Give 'resume' the directory that 'run' named when it began, such as results/pdms-beam.",
            ) from exc
        if changed is not None:
            return load(changed, untrusted=untrusted)
        if origin is None:
            raise OutputError(f"{self.path}: was run from Python, without a job file", "Give one with --job.")
        # Relative paths in the job still start from where the job file was.
        return parse(read_yaml(self.path / _JOB), Path(origin), untrusted=untrusted)


def _origin_of(job: Job) -> dict[str, str | bool | None]:
    """Where a job is from, and whether it was refused to execute anything, which holds for a resume, too."""
    return {"job": str(job.path.resolve()) if job.path else None, "untrusted": job.is_untrusted}


def _plain(value: Any) -> Any:
    """As YAML has it; what was given from Python may be of other types."""
    match value:
        case Mapping():
            return {str(key): _plain(entry) for key, entry in value.items()}
        case list() | tuple():
            return [_plain(entry) for entry in value]
        case None | bool():
            return value
    plain = next((kind for kind in (int, float, str) if isinstance(value, kind)), str)
    return plain(value)


def choose(output: Path | None, job: Job) -> RunDirectory:
    """The directory asked for, or the first free one of ``results/JOB``, ``results/JOB-2``, …"""
    if output is not None:
        return RunDirectory(output)
    base = Path("results")
    number = 1
    check_output(base / job.job)
    while (path := base / (job.job if number == 1 else f"{job.job}-{number}")).exists():
        number += 1
    return RunDirectory(path)


def relative(path: Path) -> str:
    """A path as short as the working directory allows."""
    return os.path.relpath(path)
