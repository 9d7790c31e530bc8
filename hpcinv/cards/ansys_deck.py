"""Supports of archives of Ansys, whose ``D`` commands name nodes one by one, and materials."""

from __future__ import annotations

from collections.abc import Mapping

from hpcinv.cards.card import number
from hpcinv.cards.deck import Deck, isotropic

_AXES = {"UX": "x", "UY": "y", "UZ": "z"}
_LOADS = ("F", "SF", "SFE", "BF", "BFE", "ACEL", "OMEGA", "CE", "CP")


def is_shell(text: str) -> bool:
    """Return False: shells of archives are not read."""
    return False


def read_deck(text: str, nodes_of_sets: Mapping[str, frozenset[int]]) -> Deck:
    """Return what the archive says; a displacement of nodes is a support if a component has just these nodes.

    Raises:
        CardError: a number is damaged.
    """
    deck = Deck()
    nodes: dict[tuple[str, float], set[int]] = {}
    unused = set[str]()
    moduli: dict[str, dict[str, float]] = {}
    laws: dict[str, None] = {}
    for line in text.splitlines():
        name, *entries = (word.strip() for word in line.split(","))
        if name.upper() == "D" and len(entries) > 2 and entries[0].isdigit():
            for label in _AXES if entries[1].upper() == "ALL" else (entries[1].upper(),):
                nodes.setdefault((label, number(entries[2] or "0", "D")), set()).add(int(entries[0]))
        elif name.upper() == "MP" and len(entries) > 2 and entries[0].upper() in ("EX", "NUXY", "PRXY"):
            moduli.setdefault(entries[1], {})[entries[0].upper()] = number(entries[2], "MP")
        elif name.upper() == "TB" and len(entries) > 1 and entries[0].upper() == "HYPER":
            laws.setdefault(entries[1] or "1")
        elif name.upper() in _LOADS:
            unused.add(name.upper())
    for material, values in moduli.items():
        poisson = values.get("PRXY", values.get("NUXY"))
        if "EX" in values and poisson is not None:
            deck.linear[material] = isotropic(values["EX"], poisson)
    if len(numbers := dict.fromkeys([*laws, *deck.linear])) > 1:  # the regions of several materials
        deck.materials = {f"material-{number_of}": number_of for number_of in numbers}
    held: dict[str, dict[str, float]] = {}
    for (label, value), members in nodes.items():
        region = next((name for name, own in nodes_of_sets.items() if own == members), None)
        if label in _AXES and region is not None:
            held.setdefault(region, {})[_AXES[label]] = value
        else:
            unused.add(f"D,{label} of {len(members):,} nodes that are not a component")
    for region, components in held.items():
        deck.support(region, components)
    deck.unused += sorted(unused)
    return deck
