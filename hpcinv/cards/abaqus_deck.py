"""Materials of sets, supports and loads of input files of Abaqus and CalculiX."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from hpcinv.cards.abaqus import Keyword, keywords
from hpcinv.cards.card import CardError, UnknownLaw, number
from hpcinv.cards.deck import Deck, Measure

_NAMED = {
    "ENCASTRE": "xyz",
    "PINNED": "xyz",
    "XSYMM": "x",
    "YSYMM": "y",
    "ZSYMM": "z",
}
"""components that a named condition of a solid holds"""
_NOT_TAKEN = (
    *("CLOAD", "TEMPERATURE", "INITIAL CONDITIONS", "CONTACT PAIR", "TIE", "EQUATION", "COUPLING", "RIGID BODY", "MPC"),
    *("SPRING", "DASHPOT", "MASS", "CONNECTOR SECTION", "SHELL SECTION", "MEMBRANE SECTION", "BEAM SECTION"),
    *("DYNAMIC", "BUCKLE", "FREQUENCY", "VISCO", "HEAT TRANSFER", "COUPLED TEMPERATURE-DISPLACEMENT"),
)
_PRESSED = re.compile(r"P[1-6]")
_OF_MATERIALS = (
    *("PLASTIC", "CREEP", "VISCOELASTIC", "HYSTERESIS", "MULLINS EFFECT", "EXPANSION", "DAMAGE INITIATION"),
    *("NO COMPRESSION", "NO TENSION"),
)


def read_deck(text: str, nodes_of_sets: Mapping[str, frozenset[int]]) -> Deck:
    """Return what the file says at the end of its last step; conditions on single nodes are not used.

    Raises:
        CardError: a number is damaged.
    """
    return _Reader(list(keywords(text))).deck()


class _Reader:
    """Reads the keywords in order.

    Attributes:
        held: displacements by set, of the conditions that hold so far.
        loads: the lines of ``*DLOAD`` and ``*DSLOAD`` that hold so far, with the size of their amplitude, by keyword,
            set and kind of load: a later step replaces them.
    """

    def __init__(self, file: Sequence[Keyword]) -> None:
        self._file, self._curves, self._deck = file, _Amplitudes(file), Deck()
        self._densities: dict[str, float] = {}
        self._held: dict[str, dict[str, float]] = {}
        self._loads: dict[tuple[str, str, str], tuple[list[str], float]] = {}
        self._spelled: dict[str, str] = {}  # sets as they are first named: case does not count
        self._single = Counter[str]()  # conditions on single nodes, by keyword
        self._turned: set[str] = set()  # sets with axes of their own

    def deck(self) -> Deck:
        deck, material, step = self._deck, "", 0
        for keyword in self._file:
            match keyword.name:
                case "STEP":
                    step += 1
                case "MATERIAL":
                    material = keyword.parameters.get("NAME", "")
                case "ELASTIC" if keyword.lines and len(keyword.lines[0]) > 1:
                    deck.linear[material] = _linear(keyword, material)
                case "DENSITY" if keyword.lines:
                    self._densities[material] = number(keyword.lines[0][0], "*DENSITY")
                case "SOLID SECTION":
                    deck.materials[keyword.parameters.get("ELSET", "")] = keyword.parameters.get("MATERIAL", "")
                case "TRANSFORM":
                    self._turned.add(keyword.parameters.get("NSET", "").lower())
                case "BOUNDARY":
                    self._read_conditions(keyword, step)
                case "DLOAD" | "DSLOAD":
                    self._read_loads(keyword, step)
                case name if name in _NOT_TAKEN:
                    deck.unused.append(f"*{name}")
                case name if name in _OF_MATERIALS:
                    deck.unused.append(f"*{name} of material {material}")
        deck.unused += [f"{name} of single nodes or elements ({count:,})" for name, count in self._single.items()]
        for name, values in self._held.items():
            if name.lower() in self._turned:
                deck.unused.append(f"support on '{name}', whose components are along the axes of *TRANSFORM")
            else:
                deck.support(name, values)
        for name in sorted(self._turned - {name.lower() for name in self._held}):
            deck.unused.append(f"*TRANSFORM of '{name}': a support on its nodes has other axes than in the file")
        self._add_loads()
        return deck

    def _read_conditions(self, keyword: Keyword, step: int) -> None:
        if keyword.parameters.get("OP", "").upper() == "NEW":
            self._held.clear()
        kind = keyword.parameters.get("TYPE", "DISPLACEMENT").upper()
        special = [name for name in ("FIXED", "USER", "SUBMODEL") if name in keyword.parameters]
        if special or kind != "DISPLACEMENT":
            self._deck.unused.append(f"*BOUNDARY, {special[0] if special else f'TYPE={kind}'}")
            return
        factor = self._curves.factor(keyword, step, self._deck)
        for name, values in self._conditions(keyword):
            entry = self._held.setdefault(self._spelled.setdefault(name.lower(), name), {})
            entry.update({axis: value * factor for axis, value in values.items()})

    def _conditions(self, keyword: Keyword) -> Iterator[tuple[str, dict[str, float]]]:
        """Yield the set and the displacements of each line of ``*BOUNDARY``."""
        for line in keyword.lines:
            name, *entries = [entry for entry in line if entry] or [""]
            if name.isdigit() or not entries:
                self._single["*BOUNDARY"] += 1
            elif entries[0].upper() in _NAMED:
                yield name, dict.fromkeys(_NAMED[entries[0].upper()], 0.0)
            else:
                first, last, value = _range(entries)
                axes = [axis for place, axis in enumerate("xyz", 1) if first <= place <= last]
                yield name, dict.fromkeys(axes, value)

    def _read_loads(self, keyword: Keyword, step: int) -> None:
        if keyword.parameters.get("OP", "").upper() == "NEW":
            self._loads = {key: load for key, load in self._loads.items() if key[0] != keyword.name}
        factor = self._curves.factor(keyword, step, self._deck)
        for line in keyword.lines:
            if line[0].isdigit():
                self._single[f"*{keyword.name}"] += 1
            elif len(line) > 1:
                name = self._spelled.setdefault(line[0].lower(), line[0])
                self._loads[keyword.name, name, line[1].upper()] = line, factor

    def _add_loads(self) -> None:
        deck = self._deck
        weights: dict[tuple[float, ...], list[str]] = {}
        for (keyword, name, kind), (line, factor) in self._loads.items():
            if keyword == "DSLOAD" and kind == "P" and len(line) > 2:
                pressure = Measure(number(line[2], "*DSLOAD") * factor, stress=1)
                deck.effects.append({"effect": "pressure", "region": name, "pressure": pressure})
            elif keyword == "DLOAD" and _PRESSED.fullmatch(kind) and len(line) > 2:
                pressure = Measure(number(line[2], "*DLOAD") * factor, stress=1)
                deck.effects.append({"effect": "pressure", "region": f"{name}-{kind}", "pressure": pressure})
            elif keyword == "DLOAD" and kind == "GRAV" and len(line) > 5:
                size, *direction = (number(entry, "*DLOAD") for entry in line[2:6])
                weights.setdefault(tuple(size * factor * entry for entry in direction), []).append(name)
            else:
                deck.unused.append(f"*{keyword}, {kind} on {name}")
        for acceleration, names in weights.items():
            self._add_weight(acceleration, names)

    def _add_weight(self, acceleration: tuple[float, ...], names: list[str]) -> None:
        """Add the gravity of sets, which is one of the whole body."""
        used = [self._densities[m] for m in self._deck.materials.values() if m in self._densities]
        if not any(used):
            self._deck.unused.append(f"*DLOAD, GRAV on {', '.join(names)}: no material has a *DENSITY")
            return
        components = [Measure(component, length=1, time=-2) for component in acceleration]
        mass = Measure(next(filter(None, used)), length=-2, stress=1, time=2)
        self._deck.effects.append({"effect": "gravity", "acceleration": components, "density": mass, "on": names})
        if len(set(used)) > 1:
            self._deck.unused.append("further *DENSITY: the job has one; give densities by region")


class _Amplitudes:
    """Amplitudes of loads at the end of the step that has them."""

    def __init__(self, file: Sequence[Keyword]) -> None:
        self._tables = {k.parameters.get("NAME", "").lower(): k for k in file if k.name == "AMPLITUDE"}
        self._periods = [0.0]
        for keyword in file:
            if keyword.name == "STEP":
                self._periods.append(1.0)
            elif keyword.name == "STATIC" and len(self._periods) > 1 and keyword.lines and len(keyword.lines[0]) > 1:
                self._periods[-1] = number(keyword.lines[0][1] or "1", "*STATIC")

    def factor(self, keyword: Keyword, step: int, deck: Deck) -> float:
        """Return the amplitude of a load at the end of its step; 1 without one."""
        name = keyword.parameters.get("AMPLITUDE", "")
        if not name:
            return 1.0
        table = self._tables.get(name.lower())
        if table is None:
            raise CardError(f"*{keyword.name}: there is no *AMPLITUDE {name}")
        end = sum(self._periods) if _is_of_total_time(table) else self._periods[step]
        kind = table.parameters.get("DEFINITION", "TABULAR").upper()
        entries = [number(entry, "*AMPLITUDE") for line in table.lines for entry in line if entry]
        points = list(zip(entries[::2], entries[1::2], strict=False))
        if kind == "TABULAR" and points and len(entries) % 2 == 0:
            return _interpolated(points, end)
        deck.unused.append(f"*AMPLITUDE {name} ({kind}) of *{keyword.name}")
        return 1.0


def _is_of_total_time(table: Keyword) -> bool:
    return table.parameters.get("TIME", "").upper() == "TOTAL TIME"


def _interpolated(points: Sequence[tuple[float, float]], time: float) -> float:
    """Return the value of a table at a time; constant outside of it."""
    before = points[0]
    if time <= before[0]:
        return before[1]
    for after in points[1:]:
        if time <= after[0]:
            share = (time - before[0]) / (after[0] - before[0])
            return before[1] + share * (after[1] - before[1])
        before = after
    return before[1]


def _linear(keyword: Keyword, material: str) -> tuple[float, float]:
    """Return Young's modulus and Poisson's ratio."""
    kind = keyword.parameters.get("TYPE", "ISOTROPIC").upper()
    if kind not in ("ISO", "ISOTROPIC"):
        raise UnknownLaw(f"*ELASTIC, TYPE={kind} of material {material} has no counterpart")
    if len(keyword.lines) > 1:
        raise UnknownLaw(f"*ELASTIC of material {material} depends on temperature; keep one line of data")
    young, poisson = (number(entry, "*ELASTIC") for entry in keyword.lines[0][:2])
    return young, poisson


def _range(entries: list[str]) -> tuple[float, float, float]:
    first = number(entries[0], "*BOUNDARY")
    last = number(entries[1], "*BOUNDARY") if len(entries) > 1 else first
    return first, last, number(entries[2], "*BOUNDARY") if len(entries) > 2 else 0.0
