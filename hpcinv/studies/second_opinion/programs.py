"""Programs that can be asked for a second opinion: what each writes, runs and reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from hpcinv.mesh.source import Floats, Ints
from hpcinv.studies.second_opinion import calculix, febio
from hpcinv.studies.second_opinion.calculix_units import fitting_units
from hpcinv.studies.second_opinion.decks import DECKS, DeckFormat
from hpcinv.studies.second_opinion.loaded_body import LoadedBody
from hpcinv.studies.second_opinion.units import Units


@dataclass(frozen=True)
class Program:
    """Another program.

    Attributes:
        name: for messages.
        suffix: of its deck.
        command: returns the path of an executable, or of the installed one.
        units: returns the units of a body's deck.
        displacements: runs a deck, and returns displacements of nodes.
        version: returns the version of an executable that has run a deck.
        mixed: why its elements for bodies with an unknown pressure are not known here; empty if they have none.
    """

    name: str
    suffix: str
    command: Callable[[str | None], str]
    units: Callable[[LoadedBody], Units]
    displacements: Callable[[str, Path, Ints, float, int | None], Floats]
    version: Callable[[str, Path], str]
    mixed: str = ""

    @property
    def deck(self) -> DeckFormat:
        """Its decks."""
        return DECKS[self.suffix]


PROGRAMS: Mapping[str, Program] = {
    "calculix": Program(
        calculix.PROGRAM,
        ".inp",
        calculix.command,
        fitting_units,
        calculix.displacements,
        lambda executable, deck: calculix.version(executable),
    ),
    "febio": Program(
        febio.PROGRAM,
        ".feb",
        febio.command,
        lambda body: Units(1.0),
        febio.displacements,
        febio.version,
        "they have one pressure each",
    ),
}
"""by their names in jobs and commands"""
