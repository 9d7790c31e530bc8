"""Slurm as its users have it, for tests: commands typed in a directory, jobs that are watched by their ids."""

from __future__ import annotations

import re
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from helpers.command_line import environment

ENDED = {"COMPLETED", "FAILED", "CANCELLED", "TIMEOUT", "NODE_FAIL", "BOOT_FAIL"}
PATIENCE = 90


class Batch:
    """Commands in ``place``, with the environment of a user of the cluster."""

    def __init__(self, slurm: dict[str, str], place: Path) -> None:
        self.place, self._slurm = place, slurm
        self._ids: list[str] = []

    def run(self, *command: object, **env: str) -> subprocess.CompletedProcess[str]:
        """One command, to its end."""
        return subprocess.run(
            [str(word) for word in command],
            cwd=self.place,
            env=environment(**(self._slurm | env)),
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=False,
        )

    def sbatch(self, *words: object, **env: str) -> str:
        """Submit a script; gives the job's id."""
        return self.submit("sbatch", *words, **env)

    def submit(self, *command: object, **env: str) -> str:
        """Type a command that submits a script; gives the job's id."""
        done = self.run(*command, **env)
        assert done.returncode == 0, done.stderr
        return self.watch(done.stdout)[0]

    def watch(self, text: str) -> list[str]:
        """The ids of the jobs that a command says to have submitted."""
        ids = re.findall(r"^(?:Submitted batch )?job (\d+)", text, re.MULTILINE)
        assert ids, text
        self._ids += ids
        return ids

    def cancel(self) -> None:
        """End the jobs that are left, and wait until they are gone."""
        if self._ids:
            self.run("scancel", *self._ids)
            for job in self._ids:
                self.wait(job)

    def facts(self, job: str) -> list[dict[str, str]]:
        """What Slurm knows of a job, or of each task of an array."""
        done = self.run("scontrol", "show", "job", "-o", job)
        assert done.returncode == 0, done.stderr
        return [dict(re.findall(r"(\w+)=(\S*)", line)) for line in done.stdout.splitlines() if line.strip()]

    def states(self, job: str) -> set[str]:
        return {fact["JobState"] for fact in self.facts(job)}

    def wait(self, job: str, states: set[str] = ENDED) -> list[dict[str, str]]:
        """Wait until the job, or every task of an array, is in one of these states."""
        self.until(lambda: self.states(job) <= states)
        return self.facts(job)

    def wait_for(self, text: str, job: str) -> None:
        """Wait until a job has printed this."""
        self.until(lambda: text in self.outputs() or self.states(job) <= ENDED)
        assert text in self.outputs(), f"never printed {text!r}:\n{self.outputs()}"

    def until(self, is_so: Callable[[], bool]) -> None:
        """Wait for something."""
        deadline = time.monotonic() + PATIENCE
        while not is_so():
            assert time.monotonic() < deadline, f"{[self.facts(job) for job in self._ids]}\n{self.outputs()}"
            time.sleep(0.1)

    def outputs(self) -> str:
        """All that jobs have printed."""
        return "".join(path.read_text(errors="replace") for path in sorted(self.place.rglob("*.out")))
