"""Supports of archives of Ansys, whose ``D`` commands name nodes one by one, and materials."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import ClassVar

from hpcinv.formats.cards.ansys import Property, property_of
from hpcinv.formats.cards.card import number
from hpcinv.formats.cards.deck import Deck, isotropic
from hpcinv.job.body_kinds import SOLID

_AXES = {"UX": "x", "UY": "y", "UZ": "z"}
_READ_ELSEWHERE = frozenset({"ET", "ETBL", "NBLO", "CMBL", "N", "TBDA", "TBTE"})
"""commands on the mesh and on tables of materials, by the first four letters, which are those that Ansys reads"""
_WITHOUT_EFFECT = frozenset(
    {"/COM", "/PRE", "/NOP", "/GO", "/GOP", "/TIT", "/UNI", "/SOL", "FINI", "/BAT", "/CON", "/WB", "/NOL", "/GOL"}
    | {"*IF", "*END", "*ELS", "NUMO", "DOF", "EXTO", "MPTE", "TOFF", "TREF", "/EOF", "/EXI", "SAVE", "ESEL", "NSEL"}
    | {"ALLS", "CMSE", "KEYO", "/POS", "SOLV", "/STA", "ANTY", "OUTR", "OUTP", "R", "RLBL", "SECT", "SECD", "SECO"}
)
"""commands on what the job has from elsewhere, on the order of a program, or on its output"""


_ELASTIC = ("EX", "EY", "EZ", "PR", "NU", "G")
"""beginnings of the names of elastic properties"""


def _is_command(name: str) -> bool:
    """Return whether the first entry of a line is a command, not a number, a format or a definition."""
    return "=" not in name and (name[:1].isalpha() or (name[:1] in "/*" and name[1:2].isalpha()))


def body_kind(text: str) -> str:
    """Return the name of the kind of the body: shells of archives are not read."""
    return SOLID.name


def read_deck(text: str, nodes_of_sets: Mapping[str, frozenset[int]]) -> Deck:
    """Return what the archive says; a displacement of nodes is a support if a component has just these nodes.

    Raises:
        CardError: a number is damaged.
    """
    reader = _ArchiveReader()
    for line in text.splitlines():
        name, *entries = (word.strip() for word in line.split(","))
        reader.read(name.upper(), entries)
    return reader.deck(nodes_of_sets)


class _ArchiveReader:
    """Reads the commands in order.

    Attributes:
        nodes: held ones by label and displacement.
        moduli: of the materials, by their names.
        laws: numbers of the materials that have a table.
    """

    def __init__(self) -> None:
        self.nodes: dict[tuple[str, float], set[int]] = {}
        self.moduli: dict[str, dict[str, float]] = {}
        self.laws: dict[str, None] = {}
        self._variables: dict[str, str] = {}
        self._unused: set[str] = set()

    def read(self, command: str, entries: list[str]) -> None:
        """Read a line by its command, in upper case."""
        if (entry := property_of(command, entries)) is not None:
            self._read_property(command, entry)
        elif reader := self._READERS.get(command[:4]):
            reader(self, entries)
        elif _is_command(command) and command[:4] not in _READ_ELSEWHERE | _WITHOUT_EFFECT:
            self._unused.add(command)

    def _read_support(self, entries: list[str]) -> None:
        if len(entries) > 2 and entries[0].isdigit():
            for label in _AXES if entries[1].upper() == "ALL" else (entries[1].upper(),):
                self.nodes.setdefault((label, number(entries[2] or "0", "D")), set()).add(int(entries[0]))

    def _read_variable(self, entries: list[str]) -> None:
        if len(entries) > 1:
            self._variables[entries[0].upper()] = entries[1]

    def _read_table(self, entries: list[str]) -> None:
        if len(entries) > 1 and entries[0].upper() == "HYPER":
            self.laws.setdefault(self._value(entries[1]) or "1")

    def _read_elements(self, entries: list[str]) -> None:
        if "SOLID" not in [word.upper() for word in entries]:
            self._unused.add("elements of an EBLOCK that are not solids, such as contacts")

    def _value(self, text: str) -> str:
        return self._variables.get(text.upper(), text)

    def _read_property(self, command: str, entry: Property) -> None:
        material = self._value(entry.material) or "1"
        if len(entry.values) > 1:
            self._unused.add(f"{command},{entry.name} of material {material} at further temperatures")
        if entry.name in ("EX", "NUXY", "PRXY") and entry.values:
            self.moduli.setdefault(material, {})[entry.name] = number(entry.values[0], command)
        elif entry.name.startswith(_ELASTIC):
            self._unused.add(f"{command},{entry.name} of material {material}")

    def deck(self, nodes_of_sets: Mapping[str, frozenset[int]]) -> Deck:
        """Return what the commands say."""
        deck = Deck()
        for material, values in self.moduli.items():
            poisson = values.get("PRXY", values.get("NUXY"))
            if "EX" in values and poisson is not None:
                deck.linear[material] = isotropic(values["EX"], poisson)
        if len(numbers := dict.fromkeys([*self.laws, *deck.linear])) > 1:  # the regions of several materials
            deck.materials = {f"material-{number_of}": number_of for number_of in numbers}
        held: dict[str, dict[str, float]] = {}
        for (label, value), members in self.nodes.items():
            region = next((name for name, own in nodes_of_sets.items() if own == members), None)
            if label in _AXES and region is not None:
                held.setdefault(region, {})[_AXES[label]] = value
            else:
                self._unused.add(f"D,{label} of {len(members):,} nodes that are not a component")
        for region, components in held.items():
            deck.support(region, components)
        deck.unused += sorted(self._unused)
        return deck

    _READERS: ClassVar[Mapping[str, Callable[[_ArchiveReader, list[str]], None]]] = {
        "D": _read_support,
        "*SET": _read_variable,
        "TB": _read_table,
        "EBLO": _read_elements,
    }
