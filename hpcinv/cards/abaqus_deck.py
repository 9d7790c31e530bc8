"""Materials of sets, supports and loads of input files of Abaqus and CalculiX."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from hpcinv.cards.abaqus import Keyword, keywords
from hpcinv.cards.card import number
from hpcinv.cards.deck import Deck, Measure

_NAMED = {
    "ENCASTRE": "xyz",
    "PINNED": "xyz",
    "XSYMM": "x",
    "YSYMM": "y",
    "ZSYMM": "z",
}
"""components that a named condition of a solid holds"""
_LOADS = (
    "CLOAD",
    "TEMPERATURE",
    "INITIAL CONDITIONS",
    "CONTACT PAIR",
    "TIE",
    "EQUATION",
    "COUPLING",
    "RIGID BODY",
    "MPC",
)


def read_deck(text: str, nodes_of_sets: Mapping[str, frozenset[int]]) -> Deck:
    """Return what the file says; conditions on single nodes are not used.

    Raises:
        CardError: a number is damaged.
    """
    deck, material = Deck(), ""
    densities: dict[str, float] = {}
    gravities: list[tuple[str, list[float]]] = []
    held: dict[str, dict[str, float]] = {}
    spelled: dict[str, str] = {}  # sets as they are first named: case does not count
    for keyword in keywords(text):
        match keyword.name:
            case "MATERIAL":
                material = keyword.parameters.get("NAME", "")
            case "ELASTIC" if keyword.lines and len(keyword.lines[0]) > 1:
                young, poisson = (number(entry, "*ELASTIC") for entry in keyword.lines[0][:2])
                deck.linear[material] = young, poisson
            case "DENSITY" if keyword.lines:
                densities[material] = number(keyword.lines[0][0], "*DENSITY")
            case "SOLID SECTION":
                deck.materials[keyword.parameters.get("ELSET", "")] = keyword.parameters.get("MATERIAL", "")
            case "BOUNDARY":
                for name, values in _conditions(keyword, deck):
                    held.setdefault(spelled.setdefault(name.lower(), name), {}).update(values)
            case "DSLOAD":
                _read_surface_loads(keyword, deck)
            case "DLOAD":
                gravities += _gravities(keyword, deck)
            case name if name in _LOADS:
                deck.unused.append(f"*{name}")
    for name, values in held.items():
        deck.support(name, values)
    for name, (size, *direction) in gravities:
        density = next((densities[m] for s, m in deck.materials.items() if m in densities), 0.0)
        if not density:
            deck.unused.append(f"*DLOAD, GRAV on {name}: no material has a *DENSITY")
            continue
        acceleration = [Measure(size * component, length=1, time=-2) for component in direction]
        mass = Measure(density, length=-2, stress=1, time=2)
        deck.effects.append({"effect": "gravity", "acceleration": acceleration, "density": mass})
    if len(set(densities.values())) > 1:
        deck.unused.append("further *DENSITY: the job has one; give densities by region")
    return deck


def _conditions(keyword: Keyword, deck: Deck) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield the set and the displacements of each line of ``*BOUNDARY``."""
    for line in keyword.lines:
        name, *entries = [entry for entry in line if entry] or [""]
        if name.isdigit() or not entries:
            deck.unused.append(f"*BOUNDARY of node {name}")
        elif entries[0].upper() in _NAMED:
            yield name, dict.fromkeys(_NAMED[entries[0].upper()], 0.0)
        else:
            first, last, value = _range(entries)
            axes = [axis for place, axis in enumerate("xyz", 1) if first <= place <= last]
            yield name, dict.fromkeys(axes, value)


def _range(entries: list[str]) -> tuple[float, float, float]:
    first = number(entries[0], "*BOUNDARY")
    last = number(entries[1], "*BOUNDARY") if len(entries) > 1 else first
    return first, last, number(entries[2], "*BOUNDARY") if len(entries) > 2 else 0.0


def _read_surface_loads(keyword: Keyword, deck: Deck) -> None:
    for line in keyword.lines:
        if len(line) > 2 and line[1].upper() == "P":
            pressure = Measure(number(line[2], "*DSLOAD"), stress=1)
            deck.effects.append({"effect": "pressure", "region": line[0], "pressure": pressure})
        else:
            deck.unused.append(f"*DSLOAD, {', '.join(line[:2])}")


def _gravities(keyword: Keyword, deck: Deck) -> Iterator[tuple[str, list[float]]]:
    for line in keyword.lines:
        if len(line) > 5 and line[1].upper() == "GRAV":
            yield line[0], [number(entry, "*DLOAD") for entry in line[2:6]]
        else:
            deck.unused.append(f"*DLOAD, {', '.join(line[:2])}")
