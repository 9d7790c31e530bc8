"""Supports, loads and materials of archives of Ansys, which name nodes, faces of elements and components."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import ClassVar

from hpcinv.base.reading.archive_conditions import CONDITIONS
from hpcinv.base.reading.cdb_files import Archive, archive_of
from hpcinv.base.reading.fault import Fault
from hpcinv.formats.cards.ansys import Property, property_of
from hpcinv.formats.cards.card import CardError, number
from hpcinv.formats.cards.deck import Deck, Measure, NodalForces, isotropic
from hpcinv.job.body_kinds import SOLID

_READ_ELSEWHERE = CONDITIONS | {"ET", "ETBL", "NBLO", "CMBL", "N", "TBDA", "TBTE"}
"""commands on mesh, conditions and tables of materials, by the first four letters, which are those that Ansys reads"""
_WITHOUT_EFFECT = frozenset(
    {"/COM", "/PRE", "/NOP", "/GO", "/GOP", "/TIT", "/UNI", "/SOL", "FINI", "/BAT", "/CON", "/WB", "/NOL", "/GOL"}
    | {"*IF", "*END", "*ELS", "NUMO", "DOF", "EXTO", "MPTE", "TOFF", "TREF", "/EOF", "/EXI", "SAVE", "ESEL"}
    | {"KEYO", "/POS", "/STA", "ANTY", "OUTR", "OUTP", "R", "RLBL", "SECT", "SECD", "SECO"}
    | {"NROP", "NSUB", "AUTO", "CNVT", "TIME", "KBC", "DELT", "EQSL", "SET", "PRNS", "/FOR", "/GRA", "/OUT", "/PAG"}
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
    """Return what the archive says at its end.

    Raises:
        CardError: a number is damaged.
    """
    reader = _ArchiveReader()
    for line in text.splitlines():
        name, *entries = (word.strip() for word in line.split("!")[0].split(","))
        reader.read(name.upper(), entries)
    try:
        return reader.deck(archive_of(text))
    except Fault as fault:
        raise CardError(fault.text) from None


class _ArchiveReader:
    """Reads the commands in order.

    Attributes:
        moduli: of the materials, by their names; with ``DENS``.
        laws: numbers of the materials that have a table.
    """

    def __init__(self) -> None:
        self.moduli: dict[str, dict[str, float]] = {}
        self.laws: dict[str, None] = {}
        self._variables: dict[str, str] = {}
        self._unused: set[str] = set()
        self._is_solved = self._is_large = False

    def read(self, command: str, entries: list[str]) -> None:
        """Read a line by its command, in upper case."""
        if (entry := property_of(command, entries)) is not None:
            self._read_property(command, entry)
        elif reader := self._READERS.get(command[:4]):
            reader(self, entries)
        elif _is_command(command) and command[:4] not in _READ_ELSEWHERE | _WITHOUT_EFFECT:
            self._unused.add(command)

    def _read_variable(self, entries: list[str]) -> None:
        if len(entries) > 1:
            self._variables[entries[0].upper()] = entries[1]

    def _read_table(self, entries: list[str]) -> None:
        if len(entries) > 1 and entries[0].upper() == "HYPER":
            self.laws.setdefault(self._value(entries[1]) or "1")

    def _read_elements(self, entries: list[str]) -> None:
        if "SOLID" not in [word.upper() for word in entries]:
            self._unused.add("elements of an EBLOCK that are not solids, such as contacts")

    def _read_size(self, entries: list[str]) -> None:
        """Read ``NLGEOM``."""
        self._is_large = bool(entries) and entries[0].upper() in ("ON", "1")

    def _read_solution(self, entries: list[str]) -> None:
        self._is_solved = True

    def _value(self, text: str) -> str:
        return self._variables.get(text.upper(), text)

    def _read_property(self, command: str, entry: Property) -> None:
        material = self._value(entry.material) or "1"
        if len(entry.values) > 1:
            self._unused.add(f"{command},{entry.name} of material {material} at further temperatures")
        if entry.name in ("EX", "NUXY", "PRXY", "DENS") and entry.values:
            self.moduli.setdefault(material, {})[entry.name] = number(entry.values[0], command)
        elif entry.name.startswith(_ELASTIC):
            self._unused.add(f"{command},{entry.name} of material {material}")

    def deck(self, archive: Archive) -> Deck:
        """Return what the commands say.

        Raises:
            CardError: a number of a support or a load is damaged.
        """
        if archive.conditions.damaged:
            raise CardError(archive.conditions.damaged[0])
        deck = Deck(is_linear=self._is_solved and not self._is_large)
        for material, values in self.moduli.items():
            poisson = values.get("PRXY", values.get("NUXY"))
            if "EX" in values and poisson is not None:
                deck.linear[material] = isotropic(values["EX"], poisson)
        if len(numbers := dict.fromkeys([*self.laws, *deck.linear])) > 1:  # the regions of several materials
            deck.materials = {f"material-{number_of}": number_of for number_of in numbers}
        _add_conditions(deck, archive)
        if any(acceleration := archive.conditions.acceleration):
            components = [Measure(0.0 - component, length=1, time=-2) for component in acceleration]
            densities = {material: values["DENS"] for material, values in self.moduli.items() if "DENS" in values}
            deck.mass_load({"effect": "gravity", "acceleration": components}, densities, "ACEL", "MP,DENS")
        deck.unused += [*sorted(self._unused), *_not_read(archive)]
        return deck

    _READERS: ClassVar[Mapping[str, Callable[[_ArchiveReader, list[str]], None]]] = {
        "*SET": _read_variable,
        "TB": _read_table,
        "EBLO": _read_elements,
        "NLGE": _read_size,
        "SOLV": _read_solution,
    }


def _add_conditions(deck: Deck, archive: Archive) -> None:
    """Add supports, pressures and forces by their regions."""
    conditions, shapes = archive.conditions, archive.shapes()
    held: dict[str, dict[str, float]] = {}
    for region in conditions.held_regions():
        held.setdefault(region.name, {}).update(region.values)
    for name, values in held.items():
        deck.support(name, values)
    for sliding in conditions.sliding_regions():
        deck.supports.append({"region": sliding.name, "fix": ["normal"], "normal": list(sliding.normal)})
    for pressed in conditions.pressed_regions(shapes):
        pressure = Measure(pressed.pressure, stress=1)
        deck.effects.append({"effect": "pressure", "region": pressed.name, "pressure": pressure})
    for loaded in conditions.force_regions(shapes):
        deck.forces.append(NodalForces(loaded.name, f"F on {len(loaded.forces):,} nodes", loaded.forces))


def _not_read(archive: Archive) -> Iterator[str]:
    """Yield what of the conditions is not in the deck."""
    conditions, shapes = archive.conditions, archive.shapes()
    yield from (f"{command} ({count:,})" for command, count in sorted(conditions.not_read.items()))
    if lost := conditions.lost_pressures(shapes):
        yield f"SFE,PRES on {lost:,} faces that are not of solid elements"
    regions = list(conditions.held_regions())
    held = {(axis, node) for region in regions for axis in region.values for node in region.nodes}
    if len(held) < sum(map(len, conditions.held.values())):
        yield "D of more than 20 different displacements of nodes that are not a component"
    if missing := len(conditions.equations) - sum(len(region.nodes) for region in conditions.sliding_regions()):
        yield f"CE of {missing:,} nodes that are not a component in a plane"
    if sum(len(region.forces) for region in conditions.force_regions(shapes)) < len(conditions.forces):
        yield "F of more than 20 different directions"
    pressed = sum(map(bool, conditions.pressed.values()))
    if sum(len(region.faces) for region in conditions.pressed_regions(shapes)) < pressed - lost:
        yield "SFE,PRES of more than 20 different pressures"
    if not archive.is_ended:
        yield "what follows the end of the file, which has no FINISH"
