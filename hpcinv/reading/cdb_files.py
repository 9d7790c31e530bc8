"""Archives of Ansys (``.cdb``, by ``CDWRITE``): nodes, solid elements with their degenerate shapes, and components.

Source: *Ansys Mechanical APDL Command Reference*, NBLOCK, EBLOCK, CMBLOCK and ETBLOCK; *Element Reference*, SOLID185,
SOLID186, SOLID187 and SOLID285.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hpcinv.reading.fault import Fault, shown
from hpcinv.reading.included_files import text_of
from hpcinv.reading.numbered_elements import Blocks, element_arrays, number, whole_number, whole_numbers

_SOLIDS = {45: 8, 95: 20, 92: 10, 185: 8, 186: 20, 187: 10, 285: 4}
"""nodes of the solid elements by their number; those below 100 are their predecessors"""
_KINDS = "SOLID185, SOLID186, SOLID187 and SOLID285, and SOLID45, SOLID92 and SOLID95"
_TETRAHEDRON = (0, 1, 2, 4, 8, 9, 11, 16, 17, 18)
"""nodes of a brick whose nodes 3, 4 and 5 to 8 coincide that a tetrahedron keeps"""
_FORMAT = re.compile(r"\(\s*(\d+)\s*i\s*(\d+)\s*(?:,\s*(\d+)\s*[eg]\s*(\d+))?", re.I)
_HEAD = 11  # numbers of an element before its nodes
_LOADS = ("D", "F", "SF", "SFE", "SFEBLOCK", "BF", "BFE", "BFBLOCK", "ACEL", "OMEGA", "MP", "MPDATA", "TB", "TBDATA")


class _Lines:
    """Lines of a file with their numbers."""

    def __init__(self, path: Path) -> None:
        self._lines = text_of(path).splitlines()
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
    """Return arrays of nodes, elements and components; ``ignored`` are commands on materials and loads."""
    lines = _Lines(path)
    tags: list[int] = []
    points: list[list[float]] = []
    kinds: dict[int, int] = {}
    elements: list[tuple[int, int, int, list[int]]] = []
    sets: dict[str, list[int]] = {}
    ignored = set[str]()
    while lines.more():
        words = [word.strip() for word in lines.next().split(",")]
        match words[0].upper():
            case "NBLOCK":
                _read_nodes(lines, tags, points)
            case "EBLOCK":
                elements += _elements(lines, words)
            case "CMBLOCK":
                _read_component(lines, words, sets)
            case "ET" if len(words) > 2:
                kinds[whole_number(words[1], lines.place)] = _kind(words[2], lines.place)
            case "ETBLOCK":
                kinds |= _types(lines)
            case keyword if keyword in _LOADS:
                ignored.add(keyword)
    blocks = Blocks()
    materials: dict[int, list[int]] = {}
    for tag, material, kind, nodes in elements:
        if kinds.get(kind) not in _SOLIDS:
            blocks.add_facet(tag, ())
            continue
        blocks.add(tag, _shape(tag, nodes))
        materials.setdefault(material, []).append(tag)
    if len(materials) > 1:
        sets |= {f"cells:material-{material}": members for material, members in materials.items()}
    return {"ignored": sorted(ignored)}, element_arrays(tags, points, blocks, sets, _KINDS)


def _kind(text: str, place: str) -> int:
    """Return the number of a type of elements, such as 186 of ``SOLID186``."""
    digits = re.sub(r"^[A-Za-z]+", "", text)
    return whole_number(digits, place) if digits else 0


def _format(lines: _Lines) -> tuple[int, int, int]:
    """Return the number of integers in a line, their width, and the width of the numbers after them."""
    text = lines.next()
    if (match := _FORMAT.match(text.strip())) is None:
        raise Fault(f"{lines.place}: '{shown(text)}' is not a format of a block", "Write it by CDWRITE,DB.")
    count, width, real = int(match[1]), int(match[2]), int(match[4] or 0)
    if not 0 < count < 100 or not 0 < width < 100 or real > 100:
        raise Fault(f"{lines.place}: '{shown(text)}' is not a format of a block", "Write it by CDWRITE,DB.")
    return count, width, real


def _fields(line: str, width: int, start: int = 0) -> Iterator[str]:
    for at in range(start, len(line.rstrip()), width):
        yield line[at : at + width]


def _is_end(line: str) -> bool:
    return line.strip().startswith("-1") or line.strip().upper().startswith("N,")


def _read_nodes(lines: _Lines, tags: list[int], points: list[list[float]]) -> None:
    count, width, real = _format(lines)
    if not real:
        raise Fault(f"{lines.place}: the format of NBLOCK has no coordinates", "Write it by CDWRITE,DB.")
    while not _is_end(line := lines.next()):
        tags.append(whole_number(line[:width], lines.place))
        position = [number(text, lines.place) for text in _fields(line, real, count * width)][:3]
        points.append(position + [0.0] * (3 - len(position)))  # zeros at the end are left out


def _elements(lines: _Lines, words: list[str]) -> Iterator[tuple[int, int, int, list[int]]]:
    """Yield number, material, type and nodes of each element of a block."""
    if "SOLID" not in [word.upper() for word in words]:
        raise Fault(f"{lines.place}: the EBLOCK is not of the kind SOLID", "Write it by CDWRITE,DB.")
    _, width, _ = _format(lines)
    while not _is_end(line := lines.next()):
        place = lines.place
        entries = whole_numbers(_fields(line, width), place)
        if len(entries) < _HEAD:
            raise Fault(f"{place}: an element has {len(entries)} numbers, not {_HEAD} and its nodes")
        count, nodes = entries[8], entries[_HEAD:]
        while len(nodes) < count:
            if _is_end(more := lines.next()):
                raise Fault(f"{place}: element {entries[10]} has {len(nodes)} nodes, not {count}")
            nodes += whole_numbers(_fields(more, width), lines.place)
        if len(nodes) != count:
            raise Fault(f"{place}: element {entries[10]} has {len(nodes)} nodes, not {count}")
        yield entries[10], entries[0], entries[1], nodes


def _shape(tag: int, nodes: list[int]) -> list[int]:
    """Return the nodes of a tetrahedron or brick; bricks with coinciding nodes are tetrahedra."""
    if len(nodes) not in (4, 8, 10, 20):
        raise Fault(f"element {tag} has {len(nodes)} nodes", f"Elements are {_KINDS}.")
    if 0 in nodes:
        raise Fault(f"element {tag} lacks middle nodes", "Give all elements their middle nodes, or none (EMID).")
    if len(nodes) in (4, 10) or len(set(nodes[:8])) == 8:
        return nodes
    if nodes[2] == nodes[3] and len(set(nodes[4:8])) == 1:
        return [nodes[i] for i in _TETRAHEDRON if i < len(nodes)]
    raise Fault(f"element {tag} is a prism or a pyramid", "Mesh the body by tetrahedra alone or by hexahedra alone.")


def _types(lines: _Lines) -> dict[int, int]:
    _, width, _ = _format(lines)
    kinds = {}
    while not _is_end(line := lines.next()):
        entries = whole_numbers(list(_fields(line, width))[:2], lines.place)
        if len(entries) == 2:
            kinds[entries[0]] = entries[1]
    return kinds


def _read_component(lines: _Lines, words: list[str], sets: dict[str, list[int]]) -> None:
    """Read a component; a negative number ends a range that the number before it begins."""
    place, kind = lines.place, words[2].upper()[:4] if len(words) > 3 else ""
    if kind not in ("NODE", "ELEM"):
        raise Fault(f"{place}: CMBLOCK is not of nodes or elements", "Is the file complete?")
    count = whole_number(words[3].split("!")[0], place)
    _, width, _ = _format(lines)
    entries: list[int] = []
    while len(entries) < count:
        line = lines.next()
        more = whole_numbers(_fields(line, width), lines.place)
        if not more:
            raise Fault(f"{place}: component '{shown(words[1])}' has {len(entries)} numbers, not {count}")
        entries += more
    members = sets.setdefault(f"{'nodes' if kind == 'NODE' else 'cells'}:{words[1]}", [])
    for entry in entries:
        if entry >= 0:
            members.append(entry)
        elif not members or not 0 <= -entry - members[-1] <= 10**8:
            raise Fault(f"{place}: component '{shown(words[1])}' has the range {entry} without a beginning")
        else:
            members += range(members[-1] + 1, -entry + 1)
