"""A run of another program within limits of time and memory, and the displacements in its file."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hpcinv.errors import HpcinvError
from hpcinv.mesh.source import Floats, Ints

_LAST_LINES = 3
_EXPONENT = re.compile(r"(\d)([-+]\d{3})$")
"""of three digits, before which Fortran writes no letter"""


class NoOpinion(HpcinvError):
    """The other program is missing, was stopped, or did not reach the load; the message says which, with its words."""

    exit_code = 5


class Block(NamedTuple):
    """The last displacements of a file: the load factor, and rows of a node's number and three components."""

    load: float
    rows: list[list[float]]


def installed(program: str, names: Iterable[str], advice: str) -> str:
    """Return the path of the first command that is installed.

    Raises:
        NoOpinion: none of them is.
    """
    for name in names:
        if path := shutil.which(name):
            return str(Path(path).absolute())  # it runs in another directory
    raise NoOpinion(f"{program}: is not installed", advice)


def run_within(program: str, arguments: Sequence[str], log: Path, limit: float, memory: int | None) -> None:
    """Run a command in the directory of its log, into which its words go.

    Args:
        program: its name, for messages.
        limit: seconds.
        memory: bytes; by default the machine's.

    Raises:
        NoOpinion: it was stopped.
    """
    memory = memory or os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with (
        log.open("wb") as output,
        subprocess.Popen(
            ["/bin/sh", "-c", f'ulimit -v {memory // 1024} && exec "$0" "$@"', *arguments],
            cwd=log.parent,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            start_new_session=True,
        ) as process,
    ):
        try:
            process.wait(limit)
        except BaseException as error:
            os.killpg(process.pid, signal.SIGKILL)
            if isinstance(error, subprocess.TimeoutExpired):
                raise stopped(program, f"was stopped after {limit:g} s", log) from None
            raise


def number(word: str) -> float:
    """Return a number as C or Fortran writes it; NaN for what is none, such as asterisks for one that does not fit."""
    try:
        return float(_EXPONENT.sub(r"\1E\2", word))
    except ValueError:
        return np.nan


def displacements_of(program: str, last: Block | None, tags: Ints, log: Path) -> Floats:
    """Return the displacements (n, 3) of nodes ``tags`` (n,) at the full load.

    Raises:
        NoOpinion: the program did not reach it, or left nodes out.
    """
    if last is None or last.load < 1 - 1e-6:
        reached = "reached no load" if last is None else f"ended at {last.load:.3g} of the load"
        raise stopped(program, reached, log)
    by_tag = {int(row[0]): row[1:] for row in last.rows if np.isfinite(row[0])}
    if missing := [tag for tag in tags.tolist() if tag not in by_tag]:
        raise stopped(program, f"printed no displacement of node {missing[0]}", log)
    found = np.array([by_tag[tag] for tag in tags.tolist()])
    if not np.isfinite(found).all():
        raise stopped(program, "printed displacements that are not finite", log)
    return found


def stopped(program: str, what: str, log: Path) -> NoOpinion:
    """Return the error of a run, with the last lines that are not empty."""
    lines = [line.strip() for line in log.read_text("utf-8", "replace").splitlines() if line.strip(" _\t")]
    words = "\n".join(f"  {line}" for line in lines[-_LAST_LINES:])
    return NoOpinion(f"{program} {what}; its last lines:\n{words}", f"Its files stay in {log.parent}.")
