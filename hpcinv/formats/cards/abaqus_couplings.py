"""``*COUPLING`` and ``*RIGID BODY`` of Abaqus and CalculiX: surfaces and sets that a reference node moves.

Source: *Abaqus Keywords Guide*, ``*COUPLING``, ``*RIGID BODY``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from hpcinv.base.reading.abaqus_keywords import Keyword, position_of
from hpcinv.base.reading.single_conditions import held_axes
from hpcinv.formats.cards.card import CardError, number

SPREAD = "distributing *COUPLING"
_RIGID = "*RIGID BODY"


class Coupling(NamedTuple):
    """What a reference node moves.

    Attributes:
        region: name of a surface, or of a node set of a rigid body.
        kind: keyword, for messages.
    """

    region: str
    kind: str

    @property
    def is_set(self) -> bool:
        """Whether the region is a set of nodes."""
        return self.kind == _RIGID


class Couplings:
    """Couplings by the number of their reference node, which is outside of all parts.

    Args:
        unused: receives what is not read.
    """

    def __init__(self, file: Sequence[Keyword], unused: list[str]) -> None:
        self._nodes = _OuterNodes(file)
        self._by_node: dict[int, Coupling] = {}
        self._turned: dict[int, int] = {}  # reference nodes by the nodes that have their rotations
        self._last: tuple[int, str] | None = None  # node and surface of the last coupling
        self.used: set[int] = set()
        """reference nodes that have a load or a motion"""
        for keyword in file:
            if keyword.name == "RIGID BODY":
                self._read_rigid_body(keyword, unused)
            elif keyword.name == "COUPLING":
                self._begin_coupling(keyword, unused)
            elif keyword.name in ("KINEMATIC", "DISTRIBUTING") and self._last is not None:
                self._end_coupling(keyword, *self._last, unused)

    def _begin_coupling(self, keyword: Keyword, unused: list[str]) -> None:
        """Read node and surface of a coupling; the next keyword says its kind."""
        node = self._nodes.number(keyword.options.get("REF NODE", ""))
        surface = keyword.options.get("SURFACE", "")
        is_along_axes = "ORIENTATION" not in keyword.options
        self._last = (node, surface) if node is not None and is_along_axes else None
        if self._last is None:
            unused.append(f"*COUPLING of {surface}")

    def _end_coupling(self, keyword: Keyword, node: int, surface: str, unused: list[str]) -> None:
        lines = [[entry for entry in line if entry] for line in keyword.lines] or [["1", "3"]]
        axes = {axis for line in lines if line for axis in held_axes(line)}
        if keyword.name == "DISTRIBUTING" or axes == set("xyz"):
            self._by_node[node] = Coupling(surface, SPREAD if keyword.name == "DISTRIBUTING" else "*COUPLING")
        else:
            unused.append(f"*COUPLING of {surface} along some axes only")

    def _read_rigid_body(self, keyword: Keyword, unused: list[str]) -> None:
        """Read a set of nodes that moves as a rigid body; CalculiX has its rotations at a node of their own."""
        options = keyword.options
        sets = [options[name] for name in ("NSET", "TIE NSET", "PIN NSET") if name in options]
        node, turned = (self._nodes.number(options.get(name, "")) for name in ("REF NODE", "ROT NODE"))
        if len(sets) != 1 or node is None or "ELSET" in options:
            unused.append("*RIGID BODY that is not one set of nodes with a reference node")
            return
        self._by_node[node] = Coupling(sets[0], _RIGID)
        if turned is not None:
            self._turned[turned] = node

    @property
    def nodes(self) -> set[int]:
        """Numbers of the reference nodes, and of the nodes with their rotations, as far as the mesh has these."""
        return {*self._by_node, *self._turned} if self._nodes.are_in_mesh else set()

    def reference(self, name: str) -> tuple[int, bool] | None:
        """Return the reference node that a number or the name of a set stands for, and whether it has the rotations.

        ``None`` if it is another node, or a set with others.
        """
        found = self._nodes.number(name)
        if found is None:
            return None
        node = self._turned.get(found, found)
        return (node, found in self._turned) if node in self._by_node else None

    def of(self, node: int) -> Coupling:
        """Return the coupling of a reference node."""
        return self._by_node[node]

    def position(self, node: int) -> tuple[float, float, float]:
        """Return the place of a reference node."""
        return self._nodes.position(node)

    def idle(self) -> Iterator[Coupling]:
        """Yield couplings whose node has neither a load nor a motion."""
        yield from (coupling for node, coupling in self._by_node.items() if node not in self.used)


class _OuterNodes:
    """Nodes and sets outside of parts and instances: all, in a file without parts."""

    def __init__(self, file: Sequence[Keyword]) -> None:
        self._keywords: list[Keyword] = []
        self._sets: dict[str, list[str]] = {}
        is_inside = False
        self.are_in_mesh = all(keyword.name not in ("PART", "INSTANCE") for keyword in file)
        """whether numbers are the mesh's: nodes outside of parts have numbers of their own"""
        for keyword in file:
            if keyword.name in ("PART", "INSTANCE", "END PART", "END INSTANCE"):
                is_inside = not keyword.name.startswith("END")
            elif not is_inside:
                self._read(keyword)

    def _read(self, keyword: Keyword) -> None:
        """Read nodes, or the first members of a set: one with more does not stand for a node."""
        name, rows = keyword.options.get("NSET", ""), keyword.rows[:2]
        members: list[str] = []
        if keyword.name == "NODE":
            self._keywords.append(keyword)
            members = [entries[0] for _, entries in rows] if name else []
        elif keyword.name == "NSET" and not {"INSTANCE", "ELSET"} & keyword.options.keys():
            members = [entry for _, entries in rows for entry in entries if entry]
            if "GENERATE" in keyword.options and len(set(members[:2])) == 1:
                members = members[:1]
        if members:
            self._sets.setdefault(name.lower(), []).extend(members)

    def number(self, name: str) -> int | None:
        """Return a number, also of the only node of a set; ``None`` if a set has other members."""
        members = set(self._sets.get(name.lower(), ())) if not name.isdigit() else {name}
        if len(members) != 1:
            return None
        (member,) = members
        inner = set(self._sets.get(member.lower(), ()))
        (member,) = inner if len(inner) == 1 else members  # a set in the set
        return int(member) if member.isdigit() else None

    def position(self, node: int) -> tuple[float, float, float]:
        for keyword in reversed(self._keywords):
            for _, entries in keyword.rows:
                if entries[0] == str(node):
                    coordinates = [number(entry or "0", "*NODE") for entry in entries[1:4]]
                    return position_of(coordinates, keyword.options.get("SYSTEM", ""), "*NODE")
        raise CardError(f"the reference node {node} of a coupling is not defined")
