"""Decks of other programs by the endings of their names: what each says of a run, and what writes it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

from hpcinv.studies.second_opinion import ansys_archive, calculix_deck, febio_model
from hpcinv.studies.second_opinion.calculix_deck import Deck
from hpcinv.studies.second_opinion.input_file import write_input_file
from hpcinv.studies.second_opinion.loaded_body import WRITERS, Ability, Writers


@dataclass(frozen=True)
class DeckFormat:
    """Decks of one kind.

    Attributes:
        loads, abilities: what they can say.
        write: writes one at a path, of a body, in `Units`.
    """

    loads: Writers
    abilities: Collection[Ability]
    write: Callable[..., Deck]


_ANSYS = DeckFormat(WRITERS, ansys_archive.ABILITIES, ansys_archive.write_archive)
DECKS: Mapping[str, DeckFormat] = {
    ".inp": DeckFormat(calculix_deck.LOADS, calculix_deck.ABILITIES, write_input_file),
    ".feb": DeckFormat(febio_model.LOADS, febio_model.ABILITIES, febio_model.write_model),
    ".cdb": _ANSYS,
    ".dat": _ANSYS,
}
