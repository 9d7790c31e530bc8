"""Supports and loads of the steps of an input file: what holds at the end, by node, element or set.

Loads of one step add up, as in Abaqus and CalculiX; a later step replaces them, and a displacement replaces another.
``OP=NEW`` of the first keyword of its kind in a step ends what earlier steps have; CalculiX ignores it in further ones,
and Abaqus wants it in all of them. Source: Dhondt, *CalculiX CrunchiX User's Manual*, ``*BOUNDARY``, ``*DLOAD``.
"""

import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any, NamedTuple

from hpcinv.base.reading.single_conditions import fortran_number, held_axes

PRESSED = re.compile(r"P([1-6]?)", re.IGNORECASE)
EDGE_LOAD = re.compile(r"EDNOR([1-4])", re.IGNORECASE)
COMPONENTS = ("1", "2", "3", "4", "5", "6")


class Value(NamedTuple):
    """A number in a line of data, and the same with the amplitude of its keyword; the step that has it."""

    step: int
    raw: float
    scaled: float


class Standing[Key: Hashable]:
    """Values that hold at the end of the steps that are read.

    Args:
        adds: whether values of one step add up.
    """

    def __init__(self, *, adds: bool) -> None:
        self._adds = adds
        self.values: dict[Key, Value] = {}

    def put(self, key: Key, step: int, raw: float, scaled: float) -> None:
        """Add a value to the values of the same step, or replace an earlier one."""
        earlier = self.values.get(key)
        if self._adds and earlier is not None and earlier.step == step:
            raw, scaled = earlier.raw + raw, earlier.scaled + scaled
        self.values[key] = Value(step, raw, scaled)

    def end_earlier(self, step: int) -> None:
        """Leave the values of this step only."""
        self.values = {key: value for key, value in self.values.items() if value.step == step}


class NewConditions:
    """Keywords that end what earlier steps have."""

    def __init__(self) -> None:
        self._seen: dict[tuple[str, int], bool] = {}

    def ends_earlier(self, keyword: str, options: Mapping[str, str], step: int) -> bool:
        """Return whether the keyword is the first of its kind in a step, and has ``OP=NEW``."""
        is_new = options.get("OP", "").upper() == "NEW"
        if (keyword, step) in self._seen:
            return False
        self._seen[keyword, step] = is_new
        return is_new

    def is_late(self, keyword: str, options: Mapping[str, str], step: int) -> bool:
        """Return whether ``OP=NEW`` comes after a keyword of its kind in the step that does not have it."""
        return options.get("OP", "").upper() == "NEW" and not self._seen.get((keyword, step), True)


def _same(value: float) -> float:
    return value


class SingleConditions:
    """Supports and loads of single nodes and elements.

    Attributes:
        held: displacements by axis and node.
        forces, moments: components from 0 by node.
        pressed: by element and number of the face, 0 for a shell.
        edges: loads by element and edge.
    """

    def __init__(self, *, has_rotations: bool) -> None:
        self._has_rotations = has_rotations
        self.held = Standing[tuple[str, int]](adds=False)
        self.forces = Standing[tuple[int, int]](adds=True)
        self.moments = Standing[tuple[int, int]](adds=True)
        self.pressed = Standing[tuple[int, int]](adds=True)
        self.edges = Standing[tuple[int, int]](adds=True)

    def end_earlier(self, keyword: str, step: int) -> None:
        """End the conditions of earlier steps of the kind of a keyword."""
        kinds: dict[str, tuple[Standing[Any], ...]] = {
            "BOUNDARY": (self.held,),
            "CLOAD": (self.forces, self.moments),
            "DLOAD": (self.pressed, self.edges),
        }
        for kind in kinds.get(keyword, ()):
            kind.end_earlier(step)

    def read(self, keyword: str, row: Sequence[str], step: int, scaled: Callable[[float], float] = _same) -> bool:
        """Read a line of data; return False if it is not of a single node or element, or of another kind.

        Args:
            scaled: value of a number with the amplitude of the keyword.

        Raises:
            ValueError: it is damaged.
        """
        if not row[0].isdigit() or len(row) < 2:
            return False
        tag = int(row[0])
        if keyword == "BOUNDARY":
            for axis, value in held_axes(row[1:], has_rotations=self._has_rotations).items():
                self.held.put((axis, tag), step, value, scaled(value))
            return True
        size = fortran_number(row[2] or "0") if len(row) > 2 else 0.0
        standing, place = self._load(keyword, row[1])
        if standing is not None:
            standing.put((tag, place), step, size, scaled(size))
        return standing is not None

    def _load(self, keyword: str, kind: str) -> tuple[Standing[tuple[int, int]] | None, int]:
        """Return what a kind of load belongs to, and its component, face or edge."""
        if keyword == "CLOAD" and kind in COMPONENTS:
            place = int(kind) - 1
            return (self.moments if place > 2 else self.forces), place % 3
        if keyword == "DLOAD" and (match := PRESSED.fullmatch(kind)):
            return self.pressed, int(match[1] or 0)
        if keyword == "DLOAD" and (match := EDGE_LOAD.fullmatch(kind)):
            return self.edges, int(match[1])
        return None, 0


def by_axis(held: Standing[tuple[str, int]]) -> dict[str, dict[int, float]]:
    """Return displacements by axis, then node, without amplitudes."""
    result: dict[str, dict[int, float]] = {}
    for (axis, node), value in held.values.items():
        result.setdefault(axis, {})[node] = value.raw
    return result


def vectors(components: Standing[tuple[int, int]], *, is_scaled: bool) -> dict[int, tuple[float, float, float]]:
    """Return vectors by node; vectors of amplitudes if ``is_scaled``."""
    result: dict[int, list[float]] = {}
    for (node, place), value in components.values.items():
        result.setdefault(node, [0.0, 0.0, 0.0])[place] = value.scaled if is_scaled else value.raw
    return {node: (x, y, z) for node, (x, y, z) in result.items()}
