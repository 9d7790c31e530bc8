"""What the loads and supports of an input file of Abaqus or CalculiX name: sets, reference nodes, axes, amplitudes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from hpcinv.base.reading.standing_conditions import PRESSED, SingleConditions
from hpcinv.formats.cards.abaqus_amplitudes import Amplitudes
from hpcinv.formats.cards.abaqus_couplings import Couplings
from hpcinv.formats.cards.abaqus_transform import Transforms
from hpcinv.formats.cards.deck import Deck, Measure
from hpcinv.job.body_kinds import SOLID


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


class SolidElements:
    """Solid elements, and the base of others: which types they have, and what loads on them mean."""

    body_kind: ClassVar[str] = SOLID.name
    has_rotations: ClassVar[bool] = False

    def has_type(self, name: str) -> bool:
        """Return whether a type of elements, in capitals, is one of them."""
        return name.startswith("C3D")

    def can_bear(self, load: str) -> bool:
        """Return whether a load by ``*DLOAD`` on a single element is read."""
        match = PRESSED.fullmatch(load)
        return match is not None and bool(match[1])

    def pressure(self, keyword: str, name: str, load: str, size: float) -> dict[str, Any] | None:
        """Return the section of a pressure on a set, or of a force by length; ``None`` if it is something else."""
        pressure = {"effect": "pressure", "region": name, "pressure": Measure(size, stress=1)}
        if (keyword, load) == ("DSLOAD", "P"):
            return pressure
        if keyword == "DLOAD" and SolidElements.can_bear(self, load):
            return pressure | {"region": f"{name}-{load}"}
        return None

    def face(self, *, is_edge: bool) -> dict[str, str]:
        """Return what the section of a pressure on single elements says of their face."""
        return {}


@dataclass(frozen=True)
class InputFile:
    """The deck that conditions are added to, and what they name.

    Attributes:
        single: conditions on single nodes and elements, which loads and supports share.
        elements: of the body.
    """

    deck: Deck
    amplitudes: Amplitudes
    transforms: Transforms
    couplings: Couplings
    sets: NodeSets
    single: SingleConditions
    elements: SolidElements

    def nodes(self, name: str) -> frozenset[int]:
        """Return the nodes of a set; none if it is unknown."""
        return self.sets.nodes(name) or frozenset()
