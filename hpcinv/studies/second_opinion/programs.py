"""Programs that can be asked for a second opinion: what each writes, runs and reads."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from hpcinv.mesh.source import Floats, Ints
from hpcinv.studies.second_opinion import calculix, calculix_deck, febio, febio_model
from hpcinv.studies.second_opinion.calculix_deck import Deck
from hpcinv.studies.second_opinion.input_file import write_input_file
from hpcinv.studies.second_opinion.loaded_body import Ability, LoadedBody, Writers


@dataclass(frozen=True)
class Program:
    """Another program.

    Attributes:
        name: for messages.
        suffix: of its deck.
        loads, abilities: what its deck can say.
        write: writes a deck of a body in a unit of length (m).
        command: returns the path of an executable, or of the installed one.
        displacements: runs a deck, and returns displacements of nodes.
        version: returns the version of an executable that has run a deck.
        mixed: why its elements for bodies with an unknown pressure are not known here; empty if they have none.
    """

    name: str
    suffix: str
    loads: Writers
    abilities: Collection[Ability]
    write: Callable[[Path, LoadedBody, float], Deck]
    command: Callable[[str | None], str]
    displacements: Callable[[str, Path, Ints, float, int | None], Floats]
    version: Callable[[str, Path], str]
    mixed: str = ""


PROGRAMS: Mapping[str, Program] = {
    "calculix": Program(
        calculix.PROGRAM,
        ".inp",
        calculix_deck.LOADS,
        calculix_deck.ABILITIES,
        write_input_file,
        calculix.command,
        calculix.displacements,
        lambda executable, deck: calculix.version(executable),
    ),
    "febio": Program(
        febio.PROGRAM,
        ".feb",
        febio_model.LOADS,
        (),
        febio_model.write_model,
        febio.command,
        febio.displacements,
        febio.version,
        "they have one pressure each",
    ),
}
"""by their names in jobs and commands"""
