"""Cards of Ansys: ``TB,HYPER`` with ``TBDATA``."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from hpcinv.formats.cards.card import (
    MOST_TERMS,
    Card,
    CardError,
    Counterpart,
    Stress,
    UnknownLaw,
    Values,
    bulk_from,
    chosen,
    number,
    polynomial,
    shown,
    triangle,
)

PROGRAM = "Ansys"
_UNITS = {"SI": "Pa", "MKS": "Pa", "CGS": "dyn/cm^2", "MPA": "MPa", "BIN": "psi"}
"""Units of stress by the name of a system (``/UNITS``)."""
_PER_LINE = 6
_RELEASE = re.compile(r"R\d+(\.\d+)?", re.I)
_MOST_CONSTANTS = 100
"""Place of a constant; no law has more. Raised, a damaged card can fill more memory."""
_WITHOUT_EFFECT = ("DENS", "ALPX", "KXX", "C", "REFT", "DAMP")


@dataclass
class _Table:
    """Data of ``TB``: its label, number of points and option, and constants by their place (from 1)."""

    label: str
    points: str
    option: str
    constants: dict[int, float] = field(default_factory=dict)
    temperatures: int = 0

    @property
    def title(self) -> str:
        return f"TB,HYPER,,,,{self.option}"


@dataclass
class _Material:
    tables: list[_Table] = field(default_factory=list)
    properties: list[str] = field(default_factory=list)


def read(text: str, name: str | None = None) -> Card:
    """Return a material of an input file.

    Raises:
        CardError: it is damaged, or has no counterpart.
    """
    reader = _CardReader()
    for command in _commands(text):
        reader.read(command)
    materials = reader.materials
    selected = chosen([known for known, material in materials.items() if material.tables], name)
    material = materials[selected]
    for table in material.tables:
        if table.label != "HYPER":
            raise UnknownLaw(f"TB,{table.label} has no counterpart")
    if len(material.tables) > 1:
        raise CardError(f"material {selected} has several TB,HYPER")
    (table,) = material.tables
    law = _law_of(table)
    notes = tuple(f"MP,{p} is not part of the law" for p in dict.fromkeys(material.properties))
    return Card(selected, table.title, replace(law, notes=law.notes + notes), reader.unit)


def _law_of(table: _Table) -> Counterpart:
    if table.temperatures > 1:
        raise UnknownLaw(f"{table.title}: parameters that depend on temperature have no counterpart")
    if table.option not in _OPTIONS:
        raise UnknownLaw(f"{table.title} has no counterpart")
    if table.points and not table.points.isdecimal():
        raise CardError(f"{table.title}: the number of terms is not a number: {table.points!r}")
    default, convert = _OPTIONS[table.option]
    constants = [table.constants.get(i, 0.0) for i in range(1, _MOST_CONSTANTS + 1)]
    return convert(constants, int(table.points or 0) or default)


class _CardReader:
    """Reads the commands in order.

    Attributes:
        materials: by name.
        unit: of stress, if the file states its units.
    """

    def __init__(self) -> None:
        self.materials: dict[str, _Material] = {}
        self.unit = ""
        self._variables: dict[str, str] = {}
        self._table: _Table | None = None
        self._last = 0  # place of the last constant

    def read(self, command: str) -> None:
        """Read a command with its entries."""
        name, *fields = (entry.strip() for entry in command.split(","))
        name = name.upper()
        fields += [""] * 6
        if "=" in name and not fields[0]:
            variable, _, value = name.partition("=")
            self._variables[variable.strip()] = value.strip()
        elif name == "/UNITS":
            self.unit = _UNITS.get(fields[0].upper(), "")
        elif name == "TB":
            option = _BY_LETTERS.get(fields[4].upper()[:4], fields[4].upper())
            self._table, self._last = _Table(fields[0].upper(), fields[3], option), 0
            self._material(fields[1]).tables.append(self._table)
        elif name.startswith("TB") and self._table is not None:
            self._read_data(name[:4], fields, self._table)
        elif (entry := property_of(name, fields)) is not None and entry.name in _WITHOUT_EFFECT:
            self._material(entry.material).properties.append(entry.name)

    def _read_data(self, name: str, fields: Sequence[str], table: _Table) -> None:
        if name == "TBTE":
            table.temperatures += 1
        elif name == "TBDA":
            constants = _constants(fields, self._variables, self._last, f"TB,{table.label}: TBDATA")
            table.constants |= constants
            self._last = max(constants, default=self._last)

    def _material(self, label: str) -> _Material:
        return self.materials.setdefault(self._variables.get(label.upper(), label) or "1", _Material())


def _constants(fields: Sequence[str], variables: Mapping[str, str], last: int, place: str) -> dict[int, float]:
    """Return constants by their places, which follow the last one unless the command says a place."""
    first = int(number(fields[0], place)) if fields[0] else last + 1
    entries = [variables.get(entry.upper(), entry) for entry in fields[1:7]]
    constants = {first + i: number(entry, place) for i, entry in enumerate(entries) if entry}
    if not 1 <= first <= _MOST_CONSTANTS or any(i > _MOST_CONSTANTS for i in constants):
        raise CardError(f"{place}: the place of a constant must be from 1 to {_MOST_CONSTANTS}, not {first}")
    return constants


class Property(NamedTuple):
    """A linear property: its name, its material, and its values at one or several temperatures."""

    name: str
    material: str
    values: list[str]


def property_of(command: str, fields: Sequence[str]) -> Property | None:
    """Return the property that ``MP`` or ``MPDATA`` gives; ``None`` for other commands.

    Archives have a release and a number before the name: ``MPDATA,R5.0, 1,EX, 1, 1, 10.0``.
    """
    entries = [field.strip() for field in fields]
    while entries and not entries[-1]:
        entries.pop()
    if command.upper() == "MP":
        name, material, *values = [*entries, "", ""]
        return Property(name.upper(), material, [value for value in values if value])
    if command.upper()[:4] != "MPDA":
        return None
    if _RELEASE.fullmatch(entries[0] if entries else ""):
        entries = entries[2:]
    name, material, _, *values = [*entries, "", "", ""]
    return Property(name.upper(), material, [value for value in values if value])


def _commands(text: str) -> Iterator[str]:
    for line in text.splitlines():
        for command in line.partition("!")[0].split("$"):
            if command.strip():
                yield command.strip()


_MOONEY = {
    2: [(1, 0), (0, 1)],
    3: [(1, 0), (0, 1), (1, 1)],
    5: triangle(2),
    9: triangle(3),
}
"""Powers of the invariants, in the order of the constants, by the number of parameters."""


def _mooney(c: Sequence[float], points: int) -> Counterpart:
    if points not in _MOONEY:
        raise CardError(f"TB,HYPER,,,,MOONEY has 2, 3, 5 or 9 parameters, not {points}")
    powers = _MOONEY[points]
    return polynomial(dict(zip(powers, c, strict=False)), c[points : points + 1])


def _check_order(points: int, option: str) -> None:
    if not 1 <= points <= MOST_TERMS:
        raise CardError(f"TB,HYPER,,,,{option}: the number of terms must be from 1 to {MOST_TERMS}, not {points}")


def _polynomial(c: Sequence[float], points: int) -> Counterpart:
    _check_order(points, "POLY")
    powers = triangle(points)
    return polynomial(dict(zip(powers, c, strict=False)), c[len(powers) : len(powers) + points])


def _yeoh(c: Sequence[float], points: int) -> Counterpart:
    _check_order(points, "YEOH")
    return polynomial({(i + 1, 0): c[i] for i in range(points)}, c[points : 2 * points])


def _ogden(c: Sequence[float], points: int) -> Counterpart:
    _check_order(points, "OGDEN")
    mu, alpha = c[: 2 * points : 2], c[1 : 2 * points : 2]
    first, *others = c[2 * points : 3 * points]
    if any(others):
        raise UnknownLaw("TB,HYPER,,,,OGDEN: d2 and higher have no counterpart")
    material = {"law": "ogden", "mu": [Stress(m) for m in mu], "alpha": list(alpha), "kappa": bulk_from(first)}
    return Counterpart(material)


def _with_simo_taylor(name: str, second: str) -> Callable[[Sequence[float], int], Counterpart]:
    def convert(c: Sequence[float], points: int) -> Counterpart:
        material = {"law": name, "mu": Stress(c[0]), second: c[1], "kappa": bulk_from(c[2])}
        return Counterpart(material if c[2] == 0 else {**material, "volumetric": "simo-taylor"})

    return convert


def _blatz_ko(c: Sequence[float], points: int) -> Counterpart:
    energy = "mu/2*(I2/J**2 + 2*J - 5)"
    return Counterpart({"law": "formula", "energy": energy, "parameters": {"mu": Stress(c[0])}})


_OPTIONS: Mapping[str, tuple[int, Callable[[Sequence[float], int], Counterpart]]] = {
    "NEO": (1, lambda c, _: polynomial({(1, 0): c[0] / 2}, c[1:2])),
    "MOONEY": (2, _mooney),
    "POLY": (1, _polynomial),
    "YEOH": (1, _yeoh),
    "OGDEN": (1, _ogden),
    "BOYCE": (1, _with_simo_taylor("arruda-boyce", "lambda_m")),
    "GENT": (1, _with_simo_taylor("gent", "jm")),
    "BLATZ": (1, _blatz_ko),
}
"""Default number of terms, and the counterpart from the constants and the number of terms."""
_BY_LETTERS = {name[:4]: name for name in _OPTIONS}
"""options by their first letters, which Ansys reads"""


def write(values: Values, name: str, material: int = 1) -> str:
    """Return the card of a law, with the number of its material.

    Raises:
        UnknownLaw: it has no counterpart.
    """
    option, points, constants = values.writer(_CARDS, "TB,HYPER has no such energy")(values)
    lines = [f"! {name}", f"TB,HYPER,{material},,{points},{option}"]
    for i in range(0, len(constants), _PER_LINE):
        lines.append(",".join([f"TBDATA,{i + 1}", *map(shown, constants[i : i + _PER_LINE])]))
    return "\n".join([*lines, ""])


type _Numbers = tuple[str, int | str, Sequence[float]]


def _neo_card(values: Values) -> _Numbers:
    if values.kind == "neo-hookean" and not values.is_incompressible:
        raise values.refusal("its energy has I1 and ln(J), TB,HYPER has I1_bar; take isochoric-neo-hookean")
    return "NEO", "", (values["mu"], values.compliance())


def _ogden_card(values: Values) -> _Numbers:
    pairs = [x for pair in zip(values["mu"], values["alpha"], strict=True) for x in pair]
    order = len(pairs) // 2
    return "OGDEN", order, (*pairs, values.compliance(), *[0.0] * (order - 1))


_CARDS: Mapping[str, Callable[[Values], _Numbers]] = {
    "neo-hookean": _neo_card,
    "isochoric-neo-hookean": _neo_card,
    "mooney-rivlin": lambda v: ("MOONEY", 2, (v["c1"], v["c2"], v.compliance())),
    "yeoh": lambda v: ("YEOH", 3, (v["c1"], v["c2"], v["c3"], v.compliance(), 0.0, 0.0)),
    "ogden": _ogden_card,
    "arruda-boyce": lambda v: ("BOYCE", "", (v["mu"], v["lambda_m"], v.compliance("simo-taylor"))),
    "gent": lambda v: ("GENT", "", (v["mu"], v["jm"], v.compliance("simo-taylor"))),
}
