"""Decks of CalculiX and Abaqus, of solids and of shells."""

from __future__ import annotations

from pathlib import Path

from hpcinv.errors import OutputError
from hpcinv.job.body_kinds import SHELL, SOLID
from hpcinv.studies.second_opinion.calculix_deck import Deck, Program, write_deck
from hpcinv.studies.second_opinion.calculix_shell import write_shell
from hpcinv.studies.second_opinion.loaded_body import LoadedBody
from hpcinv.studies.second_opinion.units import Units


def write_input_file(path: Path, body: LoadedBody, units: Units, program: Program = "calculix") -> Deck:
    """Write the deck of any body; as `hpcinv.studies.second_opinion.calculix_deck.write_deck`."""
    if body.steps and body.rest.body_kind != SOLID.name:
        raise OutputError("steps: a deck of a shell has one state", "Export a deck of each state, with --shape NAME.")
    return _WRITERS[body.rest.body_kind](path, body, units, program)


_WRITERS = {SOLID.name: write_deck, SHELL.name: write_shell}
