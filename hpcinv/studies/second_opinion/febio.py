"""FEBio: its version, a run of a model within limits, and the displacements in the file that the model asks for.

Sources: *FEBio User Manual*, "Running FEBio on a command line" and "Logfile"; FEBio's ``DataRecord.cpp``.
"""

from __future__ import annotations

import re
from pathlib import Path

from hpcinv.mesh.source import Floats, Ints
from hpcinv.studies.second_opinion.febio_model import displacement_path
from hpcinv.studies.second_opinion.program_run import Block, displacements_of, installed, number, run_within

PROGRAM = "FEBio"
COMMANDS = ("febio4", "febio")


def command(given: str | None) -> str:
    """Return the path of the program.

    Raises:
        NoOpinion: it is not installed.
    """
    advice = "Install FEBio 4 from febio.org, and give --command PATH."
    return installed(given or PROGRAM, (given,) if given else COMMANDS, advice)


def version(program: str, model: Path) -> str:
    """Return the version in the words of the run of a model; empty if it has none."""
    log = _log(model)
    found = re.search(r"version\s+(\d[\w.]*)", log.read_text("utf-8", "replace") if log.is_file() else "", re.I)
    return found[1] if found else ""


def displacements(program: str, model: Path, tags: Ints, limit: float, memory: int | None = None) -> Floats:
    """Run a model, and return the displacements (n, 3) of its nodes ``tags`` (n,), in its unit of length.

    The words of the program are in NAME-words.txt next to the model; FEBio itself writes NAME.log.

    Args:
        limit: seconds.
        memory: bytes; by default the machine's.

    Raises:
        NoOpinion: it did not reach the full load within the limits.
    """
    results, log = displacement_path(model), _log(model)
    results.unlink(missing_ok=True)
    run_within(PROGRAM, [program, "-i", model.name], log, limit, memory)
    return displacements_of(PROGRAM, _last_block(results), tags, log)


def _log(model: Path) -> Path:
    return model.with_name(f"{model.stem}-words.txt")


def _last_block(path: Path) -> Block | None:
    """Return time and rows of the last displacements in a file of data; ``None`` without any."""
    if not path.is_file():
        return None
    _, is_there, last = path.read_text("utf-8", "replace").rpartition("*Time")
    if not is_there:
        return None
    head, *lines = last.splitlines()
    rows = [line.split(",") for line in lines if line.count(",") == 3]
    return Block(number(head.strip(" =")), [[number(word) for word in row] for row in rows])
