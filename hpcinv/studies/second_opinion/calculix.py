"""CalculiX: its version, a run of a deck within a time limit, and the displacements that it prints."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
from pathlib import Path

import numpy as np

from hpcinv.errors import HpcinvError
from hpcinv.mesh.source import Floats, Ints

PROGRAM = "CalculiX"
COMMANDS = ("ccx", "ccx_2.21", "ccx_2.20", "ccx_2.19")
_LAST_LINES = 3
_EXPONENT = re.compile(r"(\d)([-+]\d{3})$")
"""of three digits, before which Fortran writes no letter"""


class NoOpinion(HpcinvError):
    """The other program is missing, was stopped, or did not reach the load; the message says which, with its words."""

    exit_code = 5


def command(given: str | None) -> str:
    """Return the path of the program.

    Raises:
        NoOpinion: it is not installed.
    """
    for name in (given,) if given else COMMANDS:
        if path := shutil.which(name):
            return path
    raise NoOpinion(
        f"{given or PROGRAM}: is not installed", "In Debian it is the package calculix-ccx; or give --command PATH."
    )


def version(program: str) -> str:
    """Return the version that the program prints; empty if it prints none."""
    try:
        done = subprocess.run(
            [program, "-v"], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=60
        )
    except subprocess.TimeoutExpired:
        return ""
    found = re.search(r"[Vv]ersion (\S+)", done.stdout + done.stderr)
    return found[1] if found else ""


def displacements(program: str, deck: Path, tags: Ints, limit: float, memory: int | None = None) -> Floats:
    """Run a deck, and return the displacements (n, 3) of its nodes ``tags`` (n,), in its unit of length.

    The output of the program is in NAME.log next to the deck.

    Args:
        limit: seconds.
        memory: bytes; by default the machine's.

    Raises:
        NoOpinion: it did not reach the full load within the limits.
    """
    results, log = deck.with_suffix(".dat"), deck.with_suffix(".log")
    results.unlink(missing_ok=True)
    memory = memory or os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with (
        log.open("wb") as output,
        subprocess.Popen(
            ["/bin/sh", "-c", f'ulimit -v {memory // 1024} && exec "$0" "$1"', program, deck.stem],
            cwd=deck.parent,
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
                raise _stopped(f"was stopped after {limit:g} s", log) from None
            raise
    last = _last_block(results)
    if last is None or last[0] < 1 - 1e-6:
        reached = "reached no load" if last is None else f"ended at {last[0]:.3g} of the load"
        raise _stopped(reached, log)
    by_tag = {int(row[0]): row[1:] for row in last[1] if np.isfinite(row[0])}
    if missing := [tag for tag in tags.tolist() if tag not in by_tag]:
        raise _stopped(f"printed no displacement of node {missing[0]}", log)
    found = np.array([by_tag[tag] for tag in tags.tolist()])
    if not np.isfinite(found).all():
        raise _stopped("printed displacements that are not finite", log)
    return found


def _stopped(what: str, log: Path) -> NoOpinion:
    """Return the error of a run, with the last lines that are not empty."""
    lines = [line.strip() for line in log.read_text("utf-8", "replace").splitlines() if line.strip(" _\t")]
    words = "\n".join(f"  {line}" for line in lines[-_LAST_LINES:])
    return NoOpinion(f"{PROGRAM} {what}; its last lines:\n{words}", f"Its files stay in {log.parent}.")


def _number(word: str) -> float:
    """Return a number as Fortran writes it; NaN for what is none, such as asterisks for one that does not fit."""
    try:
        return float(_EXPONENT.sub(r"\1E\2", word))
    except ValueError:
        return np.nan


def _last_block(path: Path) -> tuple[float, list[list[float]]] | None:
    """Return time and rows of the last displacements in a ``.dat`` file; ``None`` without any."""
    if not path.is_file():
        return None
    _, is_there, last = path.read_text("utf-8", "replace").rpartition("displacements")
    if not is_there:
        return None
    head, *lines = last.splitlines()
    found, block = re.search(r"time\s+([-+.\dEe]+)", head), list[list[float]]()
    for line in lines:
        words = line.split()
        if len(words) == 4:
            block.append([_number(word) for word in words])
    return (float(found[1]) if found else 0.0), block
