"""``hpcinv new job --from FILE``: a job with the mesh, materials, supports and loads of another program's file."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import JobError

if TYPE_CHECKING:
    from hpcinv.formats.cards.deck import Deck

_PROGRAMS = {".inp": "abaqus", ".feb": "febio", ".cdb": "ansys"}


def job_from(options: argparse.Namespace) -> str:
    """Return the content of a job."""
    import importlib

    from hpcinv.cli.cards import file_text
    from hpcinv.cli.file_job import FileJob
    from hpcinv.cli.mesh_input import length_unit
    from hpcinv.cli.shell_job import ShellJob
    from hpcinv.formats.cards.card import CardError
    from hpcinv.job.body_kinds import KINDS, SHELL, SOLID
    from hpcinv.mesh.io.isolated import read_isolated
    from hpcinv.mesh.kind_source import source_of

    jobs: dict[str, type[FileJob]] = {SOLID.name: FileJob, SHELL.name: ShellJob}
    path: Path = options.source
    program = _PROGRAMS.get(suffix_of(path))
    if program is None:
        raise JobError(f"--from {path}: is not an input file; the endings are {', '.join(_PROGRAMS)}")
    if options.unit is None or options.stress_unit is None:
        raise JobError("--from: files of other programs have no units; give them, as --unit mm --stress-unit MPa")
    length_unit(options.unit)
    reader = importlib.import_module(f"hpcinv.formats.cards.{program}_deck")
    try:
        text = file_text(path)
        kind: str = reader.body_kind(text)
        source = source_of(kind).read(path, None)
        action = KINDS[kind].actions.get(suffix_of(path), suffix_of(path)[1:])
        _, arrays = read_isolated(action, path, "cannot be read", "Is the file complete?")
        tags = arrays["node_tags"]
        sets = {key[6:]: frozenset(tags[rows].tolist()) for key, rows in arrays.items() if key.startswith("nodes:")}
        deck: Deck = reader.read_deck(text, sets)
        sides = {key[6:]: _side(rows) for key, rows in arrays.items() if key.startswith("faces:")}
        return jobs[kind](options, program, source, deck, text, sets, sides).text()
    except CardError as error:
        raise CardError(*(f"{path}: {problem}" for problem in error.problems)) from None
    except ValueError as error:
        raise JobError(f"{path}: {error}") from None


def _side(faces: Any) -> int:
    """Return the side of the elements that a surface is on: 1 along their normals, -1 opposite, 0 on both."""
    numbers = set(faces[:, 1].tolist())
    return {-1: -1, -2: 1}.get(numbers.pop(), 0) if len(numbers) == 1 else 0
