"""CalculiX: its version, a run of a deck within a time limit, and the displacements that it prints."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

from hpcinv.mesh.source import Floats, Ints
from hpcinv.studies.second_opinion.program_run import Block, displacements_of, installed, number, run_within

PROGRAM = "CalculiX"
COMMANDS = ("ccx", "ccx_2.21", "ccx_2.20", "ccx_2.19")


def command(given: str | None) -> str:
    """Return the path of the program.

    Raises:
        NoOpinion: it is not installed.
    """
    advice = "In Debian it is the package calculix-ccx; or give --command PATH."
    return installed(given or PROGRAM, (given,) if given else COMMANDS, advice)


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
    run_within(PROGRAM, [program, deck.stem], log, limit, memory)
    return displacements_of(PROGRAM, _last_block(results), tags, log)


def _last_block(path: Path) -> Block | None:
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
            block.append([number(word) for word in words])
    return Block(float(found[1]) if found else 0.0, block)
