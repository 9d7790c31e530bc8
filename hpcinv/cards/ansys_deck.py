"""Supports of archives of Ansys, whose ``D`` commands name nodes one by one, and materials."""

from __future__ import annotations

from collections.abc import Mapping

from hpcinv.cards.ansys import property_of
from hpcinv.cards.card import number
from hpcinv.cards.deck import Deck, isotropic

_AXES = {"UX": "x", "UY": "y", "UZ": "z"}
_READ = frozenset({"D", "ET", "ETBL", "NBLO", "EBLO", "CMBL", "N", "MP", "MPDA", "TB", "TBDA", "TBTE", "*SET"})
"""commands that are read, by the first four letters, which are those that Ansys reads"""
_WITHOUT_EFFECT = frozenset(
    {"/COM", "/PRE", "/NOP", "/GO", "/GOP", "/TIT", "/UNI", "/SOL", "FINI", "/BAT", "/CON", "/WB", "/NOL", "/GOL"}
    | {"*IF", "*END", "*ELS", "NUMO", "DOF", "EXTO", "MPTE", "TOFF", "TREF", "/EOF", "/EXI", "SAVE", "ESEL", "NSEL"}
    | {"ALLS", "CMSE", "KEYO", "/POS", "SOLV", "/STA", "ANTY", "OUTR", "OUTP", "R", "RLBL", "SECT", "SECD", "SECO"}
)
"""commands on what the job has from elsewhere, on the order of a program, or on its output"""


_KNOWN = _READ | _WITHOUT_EFFECT


def _is_command(name: str) -> bool:
    """Return whether the first entry of a line is a command, not a number, a format or a definition."""
    return name[:1].isalpha() or (name[:1] in "/*" and name[1:2].isalpha())


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
    variables: dict[str, str] = {}
    laws: dict[str, None] = {}
    for line in text.splitlines():
        name, *entries = (word.strip() for word in line.split(","))
        if name.upper() == "D" and len(entries) > 2 and entries[0].isdigit():
            for label in _AXES if entries[1].upper() == "ALL" else (entries[1].upper(),):
                nodes.setdefault((label, number(entries[2] or "0", "D")), set()).add(int(entries[0]))
        elif (entry := property_of(name, entries)) is not None:
            material = variables.get(entry.material.upper(), entry.material) or "1"
            if len(entry.values) > 1:
                unused.add(f"{name.upper()},{entry.name} of material {material} at further temperatures")
            if entry.name in ("EX", "NUXY", "PRXY") and entry.values:
                moduli.setdefault(material, {})[entry.name] = number(entry.values[0], name.upper())
            elif entry.name.startswith(("EX", "EY", "EZ", "PR", "NU", "G")):
                unused.add(f"{name.upper()},{entry.name} of material {material}")
        elif name.upper() == "*SET" and len(entries) > 1:
            variables[entries[0].upper()] = entries[1]
        elif name.upper() == "TB" and len(entries) > 1 and entries[0].upper() == "HYPER":
            laws.setdefault(variables.get(entries[1].upper(), entries[1]) or "1")
        elif name.upper()[:4] == "EBLO" and "SOLID" not in [word.upper() for word in entries]:
            unused.add("elements of an EBLOCK that are not solids, such as contacts")
        elif _is_command(name) and "=" not in name and name.upper()[:4] not in _KNOWN:
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
