"""Archives of Ansys (``.cdb``): nodes, solid elements with their degenerate shapes, components, supports and loads.

Source: *Ansys Mechanical APDL Command Reference*, NBLOCK, EBLOCK, CMBLOCK and ETBLOCK; *Element Reference*, SOLID185,
SOLID186, SOLID187 and SOLID285.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.reading.archive_conditions import BRICK, COLLAPSED, CONDITIONS, TETRAHEDRON, Conditions, Shape
from hpcinv.base.reading.fault import Fault, shown
from hpcinv.base.reading.included_files import text_of
from hpcinv.base.reading.numbered_elements import Blocks, element_arrays, number, whole_number, whole_numbers

_SOLIDS = {45: 8, 95: 20, 92: 10, 185: 8, 186: 20, 187: 10, 285: 4}
"""nodes of the solid elements by their number; those below 100 are their predecessors"""
_KINDS = "SOLID185, SOLID186, SOLID187 and SOLID285, and SOLID45, SOLID92 and SOLID95"
_OF_TETRAHEDRON = (0, 1, 2, 4, 8, 9, 11, 16, 17, 18)
"""nodes of a brick whose nodes 3, 4 and 5 to 8 coincide that a tetrahedron keeps"""
_INTEGERS = re.compile(r"(\d+)\s*i\s*(\d+)", re.I)
_FORMAT = re.compile(r"\(((?:\s*\d+\s*i\s*\d+\s*,?)+)\s*(?:(\d+)\s*[eg]\s*(\d+))?", re.I)
_HEAD = 11  # numbers of an element before its nodes
_LOADS = ("D", "F", "SF", "SFE", "SFEBLOCK", "BF", "BFE", "BFBLOCK", "ACEL", "OMEGA", "MP", "MPDATA", "TB", "TBDATA")
_OF_GEOMETRY = {"KP": "keypoints", "LINE": "lines", "AREA": "areas", "VOLU": "volumes"}
"""components of the geometry, which a mesh has not"""


class _Lines:
    """Lines of a file with their numbers."""

    def __init__(self, text: str) -> None:
        self._lines = text.splitlines()
        self.row = 0

    def more(self) -> bool:
        return self.row < len(self._lines)

    def next(self) -> str:
        if not self.more():
            raise Fault("ends within a block", "Is the file complete?")
        self.row += 1
        return self._lines[self.row - 1]

    @property
    def place(self) -> str:
        return f"line {self.row}"


def read_cdb(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return arrays of nodes, elements, components, and regions of supports and loads that are not components.

    ``ignored`` are commands on materials and loads.
    """
    return archive_of(text_of(path)).arrays()


def archive_of(text: str) -> Archive:
    """Return what an archive says; ``Fault`` if it is damaged."""
    archive, lines = Archive(), _Lines(text)
    while lines.more():
        words = [word.strip() for word in lines.next().split("!")[0].split(",")]
        command = _command(words[0])
        if reader := _READERS.get(command):
            reader(archive, lines, words)
        elif command in _LOADS:
            archive.ignored.add(command)
        if (name := command[:4]) in CONDITIONS:
            archive.conditions.read(name, words[1:], lines.next)
        archive.note_end(name)
    archive.conditions.leave_out(archive.rotated)
    return archive


class Archive:
    """What the commands of a file say.

    Attributes:
        kinds: numbers such as 186 of the types of elements, by the number of the type.
        elements: number, material, type and nodes of each.
        others: numbers of elements in blocks that are not of solids, such as contacts.
        ignored: what is not used.
        conditions: supports and loads.
        rotated: numbers of nodes whose axes are rotated.
        is_ended: whether ``FINISH`` follows the last of them, and the last material.
    """

    def __init__(self) -> None:
        self.tags: list[int] = []
        self.points: list[list[float]] = []
        self.kinds: dict[int, int] = {}
        self.elements: list[tuple[int, int, int, list[int]]] = []
        self.sets: dict[str, list[int]] = {}
        self.ignored: set[str] = set()
        self.others: list[int] = []
        self.conditions = Conditions(self.sets, self.tags)
        self.rotated: set[int] = set()
        self.is_ended = True
        self._variables: dict[str, str] = {}

    def read_nodes(self, lines: _Lines, words: list[str]) -> None:
        self.rotated |= _read_nodes(lines, self.tags, self.points)

    def read_elements(self, lines: _Lines, words: list[str]) -> None:
        if "SOLID" in [word.upper() for word in words]:
            self.elements += _elements(lines)
        else:
            self.others += _other_elements(lines)

    def read_component(self, lines: _Lines, words: list[str]) -> None:
        self.ignored.update(_read_component(lines, words, self.sets))

    def read_variable(self, lines: _Lines, words: list[str]) -> None:
        if len(words) > 2:
            self._variables[words[1].upper()] = words[2]

    def read_type(self, lines: _Lines, words: list[str]) -> None:
        if len(words) < 3:
            return
        number_of, type_name = (self._variables.get(word.upper(), word) for word in words[1:3])
        if number_of.isdigit():
            self.kinds[int(number_of)] = _kind(type_name, lines.place)
        else:
            self.ignored.add(f"ET,{shown(number_of)}")

    def read_types(self, lines: _Lines, words: list[str]) -> None:
        self.kinds |= _types(lines)

    def note_end(self, command: str) -> None:
        """Note ``FINISH``, or a command after which it must follow."""
        if command == "FINI":
            self.is_ended = True
        elif command in (*CONDITIONS, "MP", "MPDA", "TB", "TBDA", "SOLV"):
            self.is_ended = False

    def shapes(self) -> dict[int, Shape]:
        """Return the solid elements by number."""
        return {tag: _shape(tag, nodes) for tag, _, kind, nodes in self.elements if self.kinds.get(kind) in _SOLIDS}

    def arrays(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return what `read_cdb` does."""
        blocks, shapes = Blocks(), self.shapes()
        materials: dict[int, list[int]] = {}
        for tag, material, _, _ in self.elements:
            if tag in shapes:
                blocks.add(tag, shapes[tag].nodes)
                materials.setdefault(material, []).append(tag)
            else:
                blocks.add_facet(tag, ())
        for tag in self.others:
            blocks.add_facet(tag, ())
        if self.others:
            self.ignored.add(f"{len(self.others):,} elements that are not solids")
        sets = self.sets | {f"nodes:{name}": sorted(nodes) for name, nodes in self._own_regions(shapes)}
        if len(materials) > 1:
            sets |= {f"cells:material-{material}": members for material, members in materials.items()}
        arrays = element_arrays(self.tags, self.points, blocks, sets, _KINDS)
        rows = {tag: row for row, tag in enumerate(arrays["cell_tags"].tolist())}
        for region in self.conditions.pressed_regions(shapes):
            arrays[f"faces:{region.name}"] = np.array([(rows[e], face) for e, face in sorted(region.faces)])
        return {"ignored": sorted(self.ignored)}, arrays

    def _own_regions(self, shapes: Mapping[int, Shape]) -> Iterator[tuple[str, frozenset[int]]]:
        """Yield name and nodes of the supports and forces that are not components."""
        regions = [(region.name, region.nodes) for region in self.conditions.held_regions()]
        regions += [(region.name, region.nodes) for region in self.conditions.force_regions(shapes) if region.name]
        known = set(self.tags)
        for name, nodes in regions:
            if f"nodes:{name}" not in self.sets and nodes & known:
                yield name, nodes & known


_READERS: Mapping[str, Callable[[Archive, _Lines, list[str]], None]] = {
    "NBLOCK": Archive.read_nodes,
    "EBLOCK": Archive.read_elements,
    "CMBLOCK": Archive.read_component,
    "*SET": Archive.read_variable,
    "ET": Archive.read_type,
    "ETBLOCK": Archive.read_types,
}
_COMMANDS = {name[:4]: name for name in (*_READERS, *_LOADS) if len(name) > 3}


def _command(word: str) -> str:
    """Return the name of a command; Ansys reads its first four letters."""
    name = word.upper()
    return _COMMANDS.get(name[:4], name) if len(name) > 3 else name


def _kind(text: str, place: str) -> int:
    """Return the number of a type of elements, such as 186 of ``SOLID186``."""
    digits = re.sub(r"^[A-Za-z]+", "", text)
    return whole_number(digits, place) if digits else 0


def _format(lines: _Lines) -> tuple[list[int], int]:
    """Return the widths of the integers in a line, and the width of the numbers after them, 0 if there are none."""
    return block_format(lines.next(), lines.place)


def block_format(text: str, place: str) -> tuple[list[int], int]:
    """Return the widths of the integers in a line, and the width of the numbers after them, 0 if there are none."""
    match = _FORMAT.match(text.strip())
    pairs = [(int(count), int(width)) for count, width in _INTEGERS.findall(match[1])] if match else []
    real = int(match[3] or 0) if match else 0
    widths = [width for count, width in pairs for _ in range(min(count, 100))]
    if not 0 < len(widths) < 100 or not all(0 < width < 100 for width in widths) or real > 100:
        raise Fault(f"{place}: '{shown(text.strip())}' is not a format of a block", "Write it by CDWRITE,DB.")
    return widths, real


def _fields(line: str, width: int, start: int = 0) -> Iterator[str]:
    for at in range(start, len(line.rstrip()), width):
        yield line[at : at + width]


def is_end(line: str) -> bool:
    """Return whether a line ends a block."""
    return line.strip().startswith("-1") or line.strip().upper().startswith("N,")


def _read_nodes(lines: _Lines, tags: list[int], points: list[list[float]]) -> set[int]:
    """Add nodes; return the numbers of those whose axes are rotated."""
    rotated = set[int]()
    widths, real = _format(lines)
    if not real:
        raise Fault(f"{lines.place}: the format of NBLOCK has no coordinates", "Write it by CDWRITE,DB.")
    while not is_end(line := lines.next()):
        tags.append(whole_number(line[: widths[0]], lines.place))
        values = [number(text, lines.place) for text in _fields(line, real, sum(widths))]
        points.append(values[:3] + [0.0] * (3 - len(values)))  # zeros at the end are left out
        if any(values[3:6]):
            rotated.add(tags[-1])
    return rotated


def _other_elements(lines: _Lines) -> Iterator[int]:
    """Yield the numbers of the elements of a block that are not solids, such as surfaces and contacts."""
    (width, *_), _ = _format(lines)
    while not is_end(line := lines.next()):
        yield whole_number(line[:width], lines.place)


def _elements(lines: _Lines) -> Iterator[tuple[int, int, int, list[int]]]:
    """Yield number, material, type and nodes of each element of a block of solids."""
    (width, *_), _ = _format(lines)
    while not is_end(line := lines.next()):
        place = lines.place
        entries = whole_numbers(_fields(line, width), place)
        if len(entries) < _HEAD:
            raise Fault(f"{place}: an element has {len(entries)} numbers, not {_HEAD} and its nodes")
        count, nodes = entries[8], entries[_HEAD:]
        while len(nodes) < count:
            if is_end(more := lines.next()):
                raise Fault(f"{place}: element {entries[10]} has {len(nodes)} nodes, not {count}")
            nodes += whole_numbers(_fields(more, width), lines.place)
        if len(nodes) != count:
            raise Fault(f"{place}: element {entries[10]} has {len(nodes)} nodes, not {count}")
        yield entries[10], entries[0], entries[1], nodes


def _shape(tag: int, nodes: list[int]) -> Shape:
    """Return a tetrahedron or brick; bricks with coinciding nodes are tetrahedra."""
    if len(nodes) not in (4, 8, 10, 20):
        raise Fault(f"element {tag} has {len(nodes)} nodes", f"Elements are {_KINDS}.")
    if 0 in nodes:
        raise Fault(f"element {tag} lacks middle nodes", "Give all elements their middle nodes, or none (EMID).")
    if len(nodes) in (4, 10):
        return Shape(nodes, TETRAHEDRON)
    if len(set(nodes[:8])) == 8:
        return Shape(nodes, BRICK)
    if nodes[2] == nodes[3] and len(set(nodes[4:8])) == 1:
        return Shape([nodes[i] for i in _OF_TETRAHEDRON if i < len(nodes)], COLLAPSED)
    raise Fault(f"element {tag} is a prism or a pyramid", "Mesh the body by tetrahedra alone or by hexahedra alone.")


def _types(lines: _Lines) -> dict[int, int]:
    (width, *_), _ = _format(lines)
    kinds = {}
    while not is_end(line := lines.next()):
        entries = whole_numbers(list(_fields(line, width))[:2], lines.place)
        if len(entries) == 2:
            kinds[entries[0]] = entries[1]
    return kinds


def _read_component(lines: _Lines, words: list[str], sets: dict[str, list[int]]) -> list[str]:
    """Read a component, and return what is not used; a negative number ends a range that the one before it begins."""
    place, kind = lines.place, words[2].upper()[:4].strip() if len(words) > 3 else ""
    if kind not in ("NODE", "ELEM", *_OF_GEOMETRY):
        raise Fault(f"{place}: CMBLOCK is not of nodes or elements", "Is the file complete?")
    count = whole_number(words[3], place)
    (width, *_), _ = _format(lines)
    entries: list[int] = []
    while len(entries) < count:
        line = lines.next()
        more = whole_numbers(_fields(line, width), lines.place)
        if not more:
            raise Fault(f"{place}: component '{shown(words[1])}' has {len(entries)} numbers, not {count}")
        entries += more
    if kind in _OF_GEOMETRY:
        return [f"component {shown(words[1])} of {_OF_GEOMETRY[kind]}"]
    members = sets.setdefault(f"{'nodes' if kind == 'NODE' else 'cells'}:{words[1]}", [])
    for entry in entries:
        if entry >= 0:
            members.append(entry)
        elif not members or not 0 <= -entry - members[-1] <= 10**8:
            raise Fault(f"{place}: component '{shown(words[1])}' has the range {entry} without a beginning")
        else:
            members += range(members[-1] + 1, -entry + 1)
    return []
