"""What the loads and supports of an input file of Abaqus or CalculiX name: sets, reference nodes, axes, amplitudes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hpcinv.base.reading.standing_conditions import SingleConditions
from hpcinv.formats.cards.abaqus_amplitudes import Amplitudes
from hpcinv.formats.cards.abaqus_couplings import Couplings
from hpcinv.formats.cards.abaqus_transform import Transforms
from hpcinv.formats.cards.deck import Deck


class NodeSets:
    """Numbers of nodes by the name of a set, whose case does not count."""

    def __init__(self, by_name: Mapping[str, frozenset[int]]) -> None:
        self._sets = {name.lower(): (name, nodes) for name, nodes in by_name.items()}

    def find(self, name: str) -> tuple[str, frozenset[int]] | None:
        """Return name and nodes of a set, which may be named with its instance."""
        short = name.strip().lower()
        return self._sets.get(short) or self._sets.get(short.rpartition(".")[2])

    def nodes(self, name: str) -> frozenset[int] | None:
        """Return the nodes of a set, which may be named with its instance."""
        found = self.find(name)
        return None if found is None else found[1]


@dataclass(frozen=True)
class InputFile:
    """The deck that conditions are added to, and what they name.

    Attributes:
        single: conditions on single nodes and elements, which loads and supports share.
        is_shell: whether nodes have rotations.
    """

    deck: Deck
    amplitudes: Amplitudes
    transforms: Transforms
    couplings: Couplings
    sets: NodeSets
    single: SingleConditions
    is_shell: bool

    def nodes(self, name: str) -> frozenset[int]:
        """Return the nodes of a set; none if it is unknown."""
        return self.sets.nodes(name) or frozenset()
