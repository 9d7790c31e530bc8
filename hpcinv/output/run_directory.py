"""Directory of one run: the job as run, checkpoints, and results."""

import contextlib
import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from hpcinv.base.files.atomic import create, output_errors, replace
from hpcinv.base.files.directory_lock import NAME as LOCK
from hpcinv.base.files.directory_lock import DirectoryLock, check_unlocked
from hpcinv.base.files.inputs import changed_inputs, digest_of
from hpcinv.base.files.json_data import json_data
from hpcinv.base.files.names import check_output
from hpcinv.base.reading.door import admitted
from hpcinv.errors import CheckpointError, JobError, OutputError
from hpcinv.job.fingerprint import check_same_problem, fingerprint
from hpcinv.job.job import UNNAMED, Job, load, parse
from hpcinv.job.yaml_reader import read_yaml

_JOB, _ORIGIN, _LOG, _SUMMARY = "job.yaml", "origin.json", "run.log", "summary.json"
_CONTENT = (  # in the order in which it is removed: what is left after a kill never counts as a finished run
    *(_SUMMARY, _JOB, "checkpoints", "fields", "shape.*", "shape-*", "surface.npz", "interior.npz", "snapshots"),
    "second-opinion",
    *("summary.*", _LOG, "report.html"),
    ".*.partial",
)


@dataclass(frozen=True)
class RunDirectory:
    """``job.yaml`` as run, ``origin.json`` (where from), ``checkpoints/``, ``fields/``, ``shape.*``, ``summary.*``, and
    ``surface.npz``, ``interior.npz`` and ``snapshots/`` for pictures.

    A run that is killed at its beginning leaves nothing, ``.lock``, or ``origin.json`` without ``job.yaml``: never a
    partial file.

    Attributes:
        text: content of ``job.yaml``; left out, the content of the file that the job was read from.
        claimed: whether a claim in a ledger excludes other processes, so that no lock is needed.
    """

    path: Path
    text: str | None = None
    claimed: bool = False

    @property
    def checkpoints(self) -> Path:
        return self.path / "checkpoints"

    def summary(self) -> dict[str, Any] | None:
        """Return the content of ``summary.json``, ``None`` if it is missing or of something else."""
        try:
            content: dict[str, Any] = json.loads(admitted(self.path / _SUMMARY).read_bytes())
            _ = content["status"]
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return content

    @property
    def is_finished(self) -> bool:
        summary = self.summary()
        return summary is not None and bool(summary["status"] == "converged")

    @property
    def verdict(self) -> str:
        """Verdict of the certificate in the summary; empty if there is none."""
        certificate = (self.summary() or {}).get("certificate")
        return str(certificate.get("verdict", "")) if isinstance(certificate, dict) else ""

    @property
    def is_begun(self) -> bool:
        """True if job and origin can be read, so that a run can resume here."""
        try:
            origin, _ = self._origin()
            return origin is None or isinstance(read_yaml(self.path / _JOB), dict)
        except (OSError, ValueError, JobError):
            return False

    def check_same_problem(self, job: Job) -> None:
        """Raise ``CheckpointError`` if the results here have other physics than a job."""
        summary = self.summary() or {}
        if "fingerprint" not in summary:
            return
        kept = summary["fingerprint"]
        if summary["job"].get("accuracy"):  # its search has chosen another mesh and degree than the job's
            try:
                kept = fingerprint(self.job(None))
            except (OutputError, JobError):  # no job is left to compare with
                return
        inputs = (summary.get("mesh") or {}).get("inputs") or {}
        home = job.resolve(job.mesh.file).absolute().parent
        present = inputs | {name: digest_of(home / name) for name in changed_inputs(inputs, home)}
        check_same_problem(
            self.path / _SUMMARY,
            json_data(kept | {"inputs": inputs}),
            json_data(fingerprint(job) | {"inputs": present}),
        )

    def check_keeps_checkpoints(self, job: Job) -> None:
        """Raise ``CheckpointError`` if a resume with a job would remove the checkpoints here.

        A search for accuracy has none, and its results are of another mesh, so that they replace all that is here.
        """
        if job.accuracy and any(self.checkpoints.glob("[0-9]*")):
            raise CheckpointError(
                f"{job.path or UNNAMED}: accuracy: would remove the checkpoints in {self.checkpoints}",
                "Resume without 'accuracy', or start the job with 'run' and another --output.",
            )

    def check_free(self, *, overwrite: bool) -> None:
        """Raise ``OutputError`` if a run cannot use this directory; nothing is changed."""
        check_output(self.path)
        if self.path.exists() and not self.path.is_dir():
            raise OutputError(f"{self.path}: is a file", "Choose another --output.")
        check_unlocked(self.path)
        if not self.path.is_dir() or all(_is_remainder(entry) for entry in self.path.iterdir()):
            return
        if not (self.path / _ORIGIN).exists():
            raise OutputError(f"{self.path}: holds files that are not of a run", "Choose another --output.")
        if not overwrite:
            raise OutputError(
                f"{self.path}: holds the results of another run",
                "Choose another directory with --output, continue it by 'resume', or give --overwrite.",
            )

    def lock(self) -> DirectoryLock | None:
        """Lock the directory, if it exists, against other processes.

        Raises:
            OutputError: another process has locked it.
        """
        return None if self.claimed or not self.path.is_dir() else DirectoryLock(self.path)

    def create(self, job: Job, *, overwrite: bool) -> DirectoryLock | None:
        """Make the directory and write the job; files of another run there are removed, other files are kept.

        Raises:
            OutputError: it holds other results, or cannot be written.
        """
        self.check_free(overwrite=overwrite)
        with contextlib.ExitStack() as undo, output_errors(self.path, "Choose another --output."):
            text = self._text(job)  # first, since its file may be removed
            self.path.mkdir(parents=True, exist_ok=True)
            if (lock := self.lock()) is not None:
                undo.callback(lock.release)
            # The origin is kept until it is replaced: without it the directory does not count as a run.
            for old in (p for pattern in _CONTENT for p in self.path.glob(pattern)):
                shutil.rmtree(old) if old.is_dir() else old.unlink(missing_ok=True)
            self._write_origin(job, overwrite=overwrite)
            if text is not None:
                replace(self.path / _JOB, text.encode())
            undo.pop_all()  # the run releases the lock
        return lock

    def withdraw(self) -> None:
        """Remove what `create` has made, and the log, unless there is anything else in the directory."""
        with contextlib.suppress(OSError):
            if {entry.name for entry in self.path.iterdir()} <= {_JOB, _ORIGIN, _LOG, LOCK}:
                for name in (_JOB, _LOG, LOCK, _ORIGIN):
                    (self.path / name).unlink(missing_ok=True)
                self.path.rmdir()

    def _write_origin(self, job: Job, *, overwrite: bool) -> None:
        path, content = self.path / _ORIGIN, _origin_of(job)
        if overwrite and path.exists():
            replace(path, content)
        elif not create(path, content):  # one of two runs that start together, without locks, too
            raise OutputError(f"{self.path}: another run has just taken it", "Choose another --output.")

    def check_in_place(self, lock: DirectoryLock | None) -> None:
        """Raise ``OutputError`` if the directory was removed since the run began."""
        if not (self.path / _ORIGIN).exists() or not (lock is None or lock.is_in_place):
            raise OutputError(
                f"{self.path}: was removed during the run; results cannot be saved",
                "Start the run again, and keep its directory until it has ended.",
            )

    def change(self, job: Job) -> None:
        """Replace the job by a changed one, for the next resume.

        Raises:
            OutputError: it cannot be written.
        """
        if job.path is None:
            return
        with output_errors(self.path):
            replace(self.path / _JOB, (self._text(job) or "").encode())
            replace(self.path / _ORIGIN, _origin_of(job))

    def _text(self, job: Job) -> str | None:
        if self.text is not None or job.path is None:
            return self.text
        with contextlib.suppress(JobError):  # a job made in Python has no file
            if read_yaml(job.path) == job.data:
                return admitted(job.path).read_text(encoding="utf-8")
        return as_yaml(job.data)

    def _origin(self) -> tuple[str | None, bool]:
        """Return the file from which the job was read, and whether the job is untrusted."""
        try:
            content = json.loads(admitted(self.path / _ORIGIN).read_text())
            origin, untrusted = content["job"], bool(content.get("untrusted", False))
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError("it names no job") from error
        return None if origin is None else str(origin), untrusted

    def holds(self, job: Job) -> bool:
        """Return whether the job that was run here is this one."""
        try:
            return self.job(None) == job
        except (OutputError, JobError):
            return False

    def job(self, changed: Path | None) -> Job:
        """Return the job to resume: the one that was run, or the job in a ``changed`` file.

        Raises:
            OutputError: this is not the directory of a run.
            JobError: the job is not valid.
        """
        if not (self.path / _ORIGIN).exists():
            raise OutputError(
                f"{self.path}: is not the directory of a run",
                "Give 'resume' the directory that 'run' printed at its beginning, such as results/pdms-beam.",
            )
        try:
            origin, untrusted = self._origin()
        except (OSError, ValueError):
            origin, untrusted = "", False
        if changed is not None:
            return load(changed, untrusted=untrusted)
        if origin is None:
            raise OutputError(f"{self.path}: was run from Python, without a job file", "Give one with --job.")
        if not origin or not (self.path / _JOB).exists():
            job, here = os.path.relpath(origin) if origin else "JOB", os.path.relpath(self.path)
            raise OutputError(
                f"{self.path}: the run was interrupted at its beginning, before its job was saved",
                f"Start it again: mpirun -n N python -m hpcinv run {job} --output {here} --overwrite",
            )
        # Relative paths in the job are relative to the original job file.
        return parse(read_yaml(self.path / _JOB), Path(origin), untrusted=untrusted)


def as_yaml(content: Mapping[str, Any]) -> str:
    """Return the content of a job as YAML; values given from Python may be of any type."""
    return yaml.safe_dump(_plain(content), sort_keys=False, allow_unicode=True)


def _plain(value: Any) -> Any:
    match value:
        case Mapping():
            return {str(key): _plain(entry) for key, entry in value.items()}
        case list() | tuple():
            return [_plain(entry) for entry in value]
        case None | bool():
            return value
    plain = next((kind for kind in (int, float, str) if isinstance(value, kind)), str)
    return plain(value)


def _origin_of(job: Job) -> bytes:
    """Return the content of ``origin.json``: the job file, and whether the job is untrusted, also for a resume."""
    origin = str(job.path.resolve()) if job.path else None
    return json.dumps({"job": origin, "untrusted": job.is_untrusted}).encode()


def _is_remainder(path: Path) -> bool:
    """Return whether a file is one that a run leaves if it is killed at its beginning."""
    return path.name == LOCK or (path.name.startswith(".") and path.name.endswith(".partial"))


def choose(output: Path | None, job: Job, *, overwrite: bool = False) -> RunDirectory:
    """Return the given directory, or the first free one of ``results/JOB``, ``results/JOB-2``, …

    Args:
        overwrite: return ``results/JOB`` instead, also if it is not free.
    """
    if output is not None:
        return RunDirectory(output)
    base = Path("results")
    number = 1
    check_output(base / job.job)
    if overwrite:
        return RunDirectory(base / job.job)
    while (path := base / (job.job if number == 1 else f"{job.job}-{number}")).exists():
        number += 1
    return RunDirectory(path)
