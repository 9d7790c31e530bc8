"""Input files of Abaqus and CalculiX (``.inp``): nodes, solid elements, sets and surfaces by element faces.

Numbers of nodes and elements are unique within a part. A part that has several instances is read once for each.
Sources: *Abaqus Keywords Guide*; Dhondt, *CalculiX CrunchiX User's Manual*, "Element types".
"""

import contextlib
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.reading.fault import Fault, shown
from hpcinv.reading.included_files import lines_of
from hpcinv.reading.single_conditions import force_groups, fortran_number, held_axes, held_groups, pressed_groups

FACES = {
    4: ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    8: ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
}
"""vertices of the faces S1, S2, … of an element, by its number of vertices"""
_SOLID = re.compile(r"C3D(4|10|8|20|27)[A-Z]*")
_SHELL = re.compile(r"(?:S|STRI|M3D)(3|4|6|8|9)[A-Z0-9]*", re.ASCII)
_NOT_SOLID = re.compile(
    r"(?:CPS|CPE|CAX|S|STRI|M3D|SFM3D|R3D|DS|T[23]D|B3|C1D|MASS|ROTARYI|DASHPOT|GAP|DCOUP|CONN)\w*|D", re.ASCII
)
_DATA = re.compile(r"[-+.,\s\deEdD]+")
"""a line of numbers, whose keyword is lost if it is the first one"""
_FACE = re.compile(r"S([1-6])", re.IGNORECASE)
_EDGE = re.compile(r"(?:E|EDGE)([1-4])|S([3-6])", re.IGNORECASE)
"""edge of a shell: Abaqus' E1, E2, …, CalculiX' S3, S4, …"""
_WHOLE = {"": -1, "SNEG": -1, "S1": -1, "SPOS": -2, "S2": -2}
"""a whole shell element, whose side along its normal is SPOS"""
_PRESSED = re.compile(r"P([1-6]?)", re.IGNORECASE)
_EDGE_LOAD = re.compile(r"EDNOR([1-4])", re.IGNORECASE)
_THICKNESS = "values:nodal_thickness"
_WITHOUT_EFFECT = ("HEADING", "ASSEMBLY", "END ASSEMBLY", "END STEP", "PREPRINT", "RESTART", "OUTPUT")
_INSTANCE = "instance "  # begins the name of a part that holds the sets of an instance
_OWN_MESH = "mesh of instance "  # begins the name of a part that holds what is within an instance
_GENERATED = "generated"  # marks members of a generated set, whose range may have numbers that are not defined
_MOST_GENERATED = 10_000_000  # members of a generated set; more are a damaged line


@dataclass
class _Part:
    """Nodes, elements and sets of a part, or of a file without parts; sets by their names in lower case."""

    nodes: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    elements: dict[int, list[int]] = field(default_factory=dict)
    others: set[int] = field(default_factory=set)  # elements that are not solids
    names: dict[tuple[str, str], str] = field(default_factory=dict)
    sets: dict[tuple[str, str], list[tuple[str, str]]] = field(default_factory=dict)
    shared: set[tuple[str, str]] = field(default_factory=set)  # of the assembly, which other instances may have too
    thickness: list[tuple[list[str], str]] = field(default_factory=list)  # rows of *NODAL THICKNESS, and their places

    def members(self, kind: str, name: str) -> list[tuple[str, str]]:
        key = kind, name.lower()
        self.names.setdefault(key, name)
        return self.sets.setdefault(key, [])


@dataclass
class _Keyword:
    place: str
    keyword: str
    options: Mapping[str, str]
    rows: list[tuple[str, list[str]]]


@dataclass
class _Single:
    """Supports and loads of single nodes and elements; a later line replaces an earlier one."""

    has_rotations: bool = False  # of shells
    held: dict[str, dict[int, float]] = field(default_factory=dict)
    forces: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    moments: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    pressed: dict[tuple[int, int], float] = field(default_factory=dict)
    edges: dict[tuple[int, int], float] = field(default_factory=dict)

    def read(self, card: _Keyword) -> None:
        """Read the lines that name a node or an element by its number; damaged ones are read elsewhere."""
        for _, row in card.rows:
            if row[0].isdigit() and len(row) > 1:
                with contextlib.suppress(ValueError):
                    self._read_line(card.keyword, int(row[0]), row[1:])

    def _read_line(self, keyword: str, number: int, row: list[str]) -> None:
        if keyword == "BOUNDARY":
            for axis, value in held_axes(row, has_rotations=self.has_rotations).items():
                self.held.setdefault(axis, {})[number] = value
        elif keyword == "CLOAD" and row[0] in ("1", "2", "3", "4", "5", "6") and len(row) > 1:
            place = int(row[0]) - 1
            vectors = self.moments if place > 2 else self.forces
            vector = list(vectors.get(number, (0.0, 0.0, 0.0)))
            vector[place % 3] = fortran_number(row[1])
            vectors[number] = (vector[0], vector[1], vector[2])
        elif keyword == "DLOAD" and (match := _PRESSED.fullmatch(row[0])) and len(row) > 1:
            self.pressed[number, int(match[1] or 0)] = fortran_number(row[1])
        elif keyword == "DLOAD" and (match := _EDGE_LOAD.fullmatch(row[0])) and len(row) > 1:
            self.edges[number, int(match[1])] = fortran_number(row[1])

    def add_sets(self, part: _Part) -> None:
        """Add a set for each of their regions, of what is defined, if the file has no set of its name."""
        nodes = {name: nodes for name, _, nodes in held_groups(self.held)} | dict(force_groups(self.forces))
        if self.has_rotations:
            nodes |= dict(force_groups(self.moments, "turned"))
        for name, members in nodes.items():
            if ("nodes", name) not in part.sets:
                part.members("nodes", name).extend((str(node), "") for node in sorted(members & part.nodes.keys()))
        pressed = [(group, "S") for group in pressed_groups(self.pressed)]
        for (name, _, places), letter in [*pressed, *((g, "E") for g in pressed_groups(self.edges, "edge-loaded"))]:
            if ("faces", name) not in part.sets:
                known = sorted(place for place in places if place[0] in part.elements)
                faces = ((str(element), f"{letter}{face}" if face else "") for element, face in known)
                part.members("faces", name).extend(faces)


def read_inp(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the keywords that are not used, and arrays: nodes, elements and sets.

    Arrays are ``points`` (n, 3), ``node_tags`` (n,), ``cells`` (m, k) in the order of the file, ``cell_tags`` (m,),
    ``cells:NAME`` and ``nodes:NAME`` (rows of the members of a set), ``faces:NAME`` (cell, number of the face from 0).
    """
    head, arrays, cells = _content(path, _SOLID)
    sizes = {len(cell) for cell in cells}
    if len(sizes) > 1:
        raise Fault(f"has elements of {' and '.join(map(str, sorted(sizes)))} nodes", "Use one kind of elements.")
    return head, {"points": arrays.pop("points"), "cells": np.array(cells, dtype=np.int64)} | arrays


def read_inp_shells(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the same of shell and membrane elements.

    Instead of ``cells`` there are ``offsets`` (m + 1,) and ``connectivity``. A surface has the number of an edge, or
    for the whole element -1, on its side along the normal -2. ``values:nodal_thickness`` (n,) is of ``*NODAL
    THICKNESS``, not a number where a cell has none.
    """
    head, arrays, cells = _content(path, _SHELL)
    offsets, connectivity = np.cumsum([0, *map(len, cells)]), np.concatenate(cells).astype(np.int64)
    if (thickness := arrays.get(_THICKNESS)) is not None:  # nodes without cells need none
        known = thickness[connectivity]
        unused = np.setdiff1d(np.arange(len(thickness)), connectivity)
        thickness[unused] = known[np.isfinite(known)].mean() if np.isfinite(known).any() else np.nan
    return head, arrays | {"offsets": offsets, "connectivity": connectivity}


def _content(path: Path, kinds: re.Pattern[str]) -> tuple[dict[str, Any], dict[str, Any], list[list[int]]]:
    """Return what `read_inp` does, and the nodes of the elements of some kinds apart."""
    parts, instances, ignored = _parts(path, kinds)
    placed = _placed(parts, instances) or [(parts[""], np.zeros(3), "")]
    points: list[Any] = []
    tags: list[int] = []
    cells: list[list[int]] = []
    cell_tags: list[int] = []
    thickness: list[float] = []
    sets: dict[str, list[Any]] = {}
    for part, shift, name in placed:
        if not part.elements:
            raise _without_elements(part, kinds)
        node_row = {tag: len(points) + i for i, tag in enumerate(part.nodes)}
        cell_row = {tag: len(cells) + i for i, tag in enumerate(part.elements)}
        points += [np.add(position, shift) for position in part.nodes.values()]
        tags += part.nodes
        cell_tags += part.elements
        for tag, nodes in part.elements.items():
            if missing := [node for node in nodes if node not in node_row]:
                raise Fault(f"element {tag} has node {missing[0]}, which is not defined")
            cells.append([node_row[node] for node in nodes])
        thickness += [math.nan] * len(part.nodes)
        for row, place in part.thickness:
            for tag in _nodes_of(part, row[0]):
                if tag in node_row:
                    thickness[node_row[tag]] = _numbers(row[1:2], place)[0]
        face = _solid_face if kinds is _SOLID else _shell_edge
        for (kind, key), spelled in part.names.items():
            rows = _rows(part, kind, key, node_row, cell_row, cells, face)
            if len(rows):
                prefix = f"{name}." if len(placed) > 1 and (kind, key) not in part.shared else ""
                sets.setdefault(f"{kind}:{prefix}{spelled}", []).extend(rows)
    if len(placed) > 1:  # numbers of several instances repeat
        tags, cell_tags = list(range(1, len(tags) + 1)), list(range(1, len(cell_tags) + 1))
    arrays: dict[str, Any] = {
        "points": np.array(points),
        "node_tags": np.array(tags, dtype=np.int64),
        "cell_tags": np.array(cell_tags, dtype=np.int64),
    }
    for name, rows in sets.items():
        arrays[name] = np.unique(np.array(rows, dtype=np.int64), axis=0)
    if kinds is _SHELL and any(part.thickness for part, _, _ in placed):
        arrays[_THICKNESS] = np.array(thickness)
    return {"ignored": sorted(ignored)}, arrays, cells


def _without_elements(part: _Part, kinds: re.Pattern[str]) -> Fault:
    """Return the fault of a part without elements of the kinds that are read."""
    if kinds is _SHELL:
        text = "Elements of shells are S3, S4, S6, S8 and S9, also with R. Leave 'shell' out for a solid."
        return Fault("has no shell elements", text)
    remedy = " For shell elements give 'mesh: {shell: {thickness: …}}'." if part.others else ""
    text = f"Elements are C3D4, C3D10, C3D8, C3D20 and C3D27, also with H, R, I or M.{remedy}"
    return Fault("has no solid elements", text)


def _parts(path: Path, kinds: re.Pattern[str]) -> tuple[dict[str, _Part], list[_Keyword], set[str]]:
    """Return parts by lower-case name (``""``: outside of parts), instances, and keywords that are not used.

    Args:
        kinds: of elements that are read.
    """
    parts: dict[str, _Part] = {"": _Part()}
    current, instances, ignored = parts[""], list[_Keyword](), set[str]()
    pressed, single = list[tuple[str, str, str]](), _Single(has_rotations=kinds is _SHELL)
    for card in _cards(path):
        options = card.options
        match card.keyword:
            case "PART":
                current = parts.setdefault(_needed(card, "NAME").lower(), _Part())
            case "END PART":
                current = parts[""]
            case "INSTANCE":
                instances.append(card)
                name = options.get("NAME", _needed(card, "PART"))
                current = parts.setdefault(f"{_OWN_MESH}{name.lower()}", _Part())
            case "END INSTANCE":
                current = parts[""]
            case "NODE":
                _read_nodes(current, card)
            case "":
                ignored.add(f"{len(card.rows):,} lines before the first keyword")
            case "ELEMENT":
                ignored.update(_read_elements(current, card, kinds))
            case "NSET" | "ELSET":
                kind, owner = ("nodes" if card.keyword == "NSET" else "cells"), current
                if instance := options.get("INSTANCE"):
                    if instance.lower() not in {known.options.get("NAME", "").lower() for known in instances}:
                        raise Fault(f"{card.place}: there is no instance '{shown(instance)}'")
                    owner = parts.setdefault(f"{_INSTANCE}{instance.lower()}", _Part())
                _read_set(owner, kind, _needed(card, card.keyword), card)
            case "SURFACE" if options.get("TYPE", "ELEMENT").upper() == "ELEMENT":
                members = current.members("faces", _needed(card, "NAME"))
                members += [(row[0], row[1] if len(row) > 1 else "") for _, row in card.rows if row[0]]
            case "SURFACE" if options.get("TYPE", "").upper() == "NODE":
                members = current.members("nodes", _needed(card, "NAME"))
                members += [(row[0], "") for _, row in card.rows if row[0]]
            case "DLOAD":  # faces of the elements of a set
                ignored.add(card.keyword)
                for _, row in card.rows:
                    if len(row) < 2 or row[0].isdigit():
                        continue
                    if (match := _PRESSED.fullmatch(row[1])) and match[1]:
                        pressed.append((f"{row[0]}-P{match[1]}", row[0], f"S{match[1]}"))
                    elif match := _EDGE_LOAD.fullmatch(row[1]):
                        pressed.append((f"{row[0]}-EDNOR{match[1]}", row[0], f"E{match[1]}"))
                single.read(card)
            case "BOUNDARY" | "CLOAD":
                ignored.add(card.keyword)
                single.read(card)
            case "NODAL THICKNESS":
                ignored.add(card.keyword)
                current.thickness += [(row, place) for place, row in card.rows]
            case "SYSTEM" | "NGEN" | "NFILL" | "ELGEN" | "NCOPY" | "ELCOPY":
                text = f"{card.place}: *{card.keyword} is not read"
                raise Fault(text, "Save the mesh with all its nodes and elements in global coordinates.")
            case name if name in _WITHOUT_EFFECT or name.endswith((" PRINT", " FILE", " OUTPUT")):
                pass
            case _:
                ignored.add(card.keyword)
    outside = parts[""]
    if not parts.keys() - {""}:
        for region, name, face in dict.fromkeys(pressed):
            if ("cells", name.lower()) in outside.sets:  # not of other elements
                outside.members("faces", region).append((name, face))
        single.add_sets(outside)
    if instances and (outside.nodes or outside.elements):
        raise Fault("has nodes outside of its parts", "Save one part, or the assembly with its parts.")
    if not instances and len(parts) == 2:
        parts[""] = next(part for name, part in parts.items() if name)
    elif not instances and len(parts) > 2:
        raise Fault(f"has {len(parts) - 1} parts and no assembly", "Save one part, or the assembly with its instances.")
    return parts, instances, ignored


def _placed(parts: Mapping[str, _Part], instances: list[_Keyword]) -> list[tuple[_Part, Any, str]]:
    """Return the part of each instance with the sets of the assembly in it, its translation, and its name."""
    outside = parts[""]
    placed = []
    for card in instances:
        name = _needed(card, "PART")
        part = parts.get(name.lower())
        if part is None:
            raise Fault(f"{card.place}: there is no part '{shown(name)}'")
        rows = [_numbers(row, place) for place, row in card.rows]
        if len(rows) > 1:
            raise Fault(f"{card.place}: the instance is rotated", "Save the mesh in global coordinates.")
        shift = np.zeros(3)
        if rows:
            shift[: len(rows[0][:3])] = rows[0][:3]
        instance = card.options.get("NAME", name)
        content = parts.get(f"{_OWN_MESH}{instance.lower()}", _Part())
        if content.nodes:  # of Abaqus/CAE's independent instances
            part, content = content, _Part()
        sets = {k: [*v] for k, v in part.sets.items()}
        own = _Part(part.nodes, part.elements, part.others, dict(part.names), sets, thickness=part.thickness)
        for more in (content, parts.get(f"{_INSTANCE}{instance.lower()}", _Part()), outside):
            for key, spelled in more.names.items():
                own.members(key[0], spelled).extend(more.sets[key])
                own.shared.add(key)
        placed.append((own, shift, instance))
    for key, spelled in outside.names.items() if instances else ():
        names = {member.lower() for member, _ in outside.sets[key] if not member.isdigit()}
        if len(instances) > 1 and len(names) < len({member for member, _ in outside.sets[key]}):
            raise Fault(f"set '{shown(spelled)}' of the assembly has numbers without instance=", "Name the instance.")
        inner = "cells" if key[0] == "faces" else key[0]
        for name in names:
            has_set = [(inner, name) in own.sets for own, _, _ in placed]
            if not any(has_set):
                raise Fault(f"set '{shown(spelled)}' has '{shown(name)}', which is not defined")
            for (own, _, _), has in zip(placed, has_set, strict=True):
                if not has:
                    own.sets[key] = [entry for entry in own.sets[key] if entry[0].lower() != name]
    return placed


def _cards(path: Path) -> Iterator[_Keyword]:
    """Yield the keywords with their lines of data; text before the first one, which CalculiX leaves out, has none."""
    card: _Keyword | None = None
    for place, line in lines_of(path):
        if line.startswith("*"):
            if card is not None:
                yield card
            card = _keyword(line, place)
        else:
            card = card or _Keyword(place, "", {}, [])
            if not card.keyword and _DATA.fullmatch(line):
                raise Fault(f"{place} is not a keyword", "Input files begin with a keyword such as *NODE.")
            card.rows.append((place, [entry.strip().strip('"') for entry in line.rstrip(",").split(",")]))
    if card is None or not card.keyword:
        raise Fault("has no keywords", "Is it an input file of Abaqus or CalculiX?")
    yield card


def _keyword(line: str, place: str) -> _Keyword:
    keyword, *options = (entry.strip() for entry in line[1:].split(","))
    pairs = (option.partition("=") for option in options if option)
    values = {name.strip().upper(): value.strip().strip('"') for name, _, value in pairs}
    return _Keyword(place, " ".join(keyword.upper().split()), values, [])


def _needed(card: _Keyword, option: str) -> str:
    if not (value := card.options.get(option, "")):
        raise Fault(f"{card.place}: *{card.keyword} needs {option}=")
    return value


def _numbers(row: list[str], place: str) -> list[float]:
    try:
        values = [float(entry.lower().replace("d", "e")) for entry in row if entry]
    except ValueError:
        raise Fault(f"{place}: '{shown(', '.join(row))}' are not numbers") from None
    if not np.isfinite(values).all():
        raise Fault(f"{place}: has a number that is not finite")
    return values


def _tags(row: list[str], place: str) -> list[int]:
    try:
        return [int(entry) for entry in row if entry]
    except ValueError:
        raise Fault(f"{place}: '{shown(', '.join(row))}' are not whole numbers") from None


def _read_nodes(part: _Part, card: _Keyword) -> None:
    group = part.members("nodes", card.options["NSET"]) if card.options.get("NSET") else []
    for place, row in card.rows:
        tag, *position = _tags(row[:1], place) + _numbers(row[1:4], place)
        if not position:
            raise Fault(f"{place}: a node has no coordinates")
        x, y, z = [*position, 0.0, 0.0][:3]  # those left out are zero
        part.nodes[int(tag)] = (x, y, z)
        group.append((str(int(tag)), ""))


def _read_elements(part: _Part, card: _Keyword, kinds: re.Pattern[str]) -> list[str]:
    """Read the elements of a keyword; return what is ignored.

    As CalculiX does, entries after the last node of an element are ignored. They are faults if lines differ in length:
    then they may be nodes of another type of elements.
    """
    kind = _needed(card, "TYPE").upper()
    match = kinds.fullmatch(kind)
    if match is None and kinds is _SHELL and _SOLID.fullmatch(kind):
        text = f"{card.place}: a shell cannot be tied to solid elements, such as {shown(kind)}"
        raise Fault(text, "Save the surface alone, or mesh all of it as a solid.")
    if match is None:
        if _NOT_SOLID.fullmatch(kind):  # such as the surface elements of mesh programs, springs and masses
            tags = [_tags(row[:1], place)[0] for place, row in card.rows if row[0]]
            part.others.update(tags)
            if card.options.get("ELSET"):
                part.members("cells", card.options["ELSET"]).extend((str(tag), "") for tag in tags)
            return []
        text = f"{card.place}: elements {shown(kind)} are not supported"
        raise Fault(text, "Use C3D4, C3D10, C3D8, C3D20 or C3D27, also with H, R, I or M.")
    count = int(match[1])
    group = part.members("cells", card.options["ELSET"]) if card.options.get("ELSET") else []
    pending: list[int] = []
    length = len(card.rows[0][1]) if len({len(row) for _, row in card.rows}) == 1 else 0
    is_longer = length > count + 1
    for place, row in card.rows:
        pending += _tags(row, place)[: count + 1 if is_longer else None]
        if len(pending) < count + 1:
            continue
        if len(pending) > count + 1:
            raise Fault(f"{place}: an element {shown(kind)} has {count} nodes, not {len(pending) - 1}")
        part.elements[pending[0]] = pending[1:]
        group.append((str(pending[0]), ""))
        pending = []
    if pending:
        raise Fault(f"{card.rows[-1][0]}: element {pending[0]} has {len(pending) - 1} nodes, not {count}")
    return [f"entries after the {count} nodes of elements {shown(kind)}"] if is_longer else []


def _read_set(part: _Part, kind: str, name: str, card: _Keyword) -> None:
    members = part.members(kind, name)
    for place, row in card.rows:
        if "GENERATE" not in card.options:
            members += [(entry, "") for entry in row if entry]
            continue
        numbers = _tags(row, place)
        first, last, step = (*numbers, 1)[:3] if len(numbers) in (2, 3) else (1, 0, 1)
        if step < 1 or not 0 < (last - first) // step + 1 <= _MOST_GENERATED:
            raise Fault(f"{place}: the generated set has no valid range")
        members += [(str(tag), _GENERATED) for tag in range(first, last + 1, step)]


def _rows(
    part: _Part,
    kind: str,
    key: str,
    node_row: Mapping[int, int],
    cell_row: Mapping[int, int],
    cells: list[list[int]],
    number_of_face: Callable[[str, int], int],
) -> list[Any]:
    """Return rows of the members of a set; pairs of a cell and a face for a surface."""
    rows: list[Any] = []
    numbers = node_row if kind == "nodes" else cell_row
    for member, face in _flattened(part, kind, key, frozenset()):
        tag = int(member)
        if kind != "nodes" and tag in part.others:
            continue
        if tag not in numbers and face == _GENERATED:
            continue
        if tag not in numbers:
            raise Fault(f"set '{shown(part.names[kind, key])}' has {tag}, which is not defined")
        if kind != "faces":
            rows.append(numbers[tag])
            continue
        try:
            rows.append((numbers[tag], number_of_face(face, len(cells[cell_row[tag]]))))
        except IndexError:
            text = f"element {tag} has no face {shown(face.upper())}"
            raise Fault(f"surface '{shown(part.names[kind, key])}': {text}") from None
        except ValueError as error:
            text = f"surface '{shown(part.names[kind, key])}': '{shown(face)}' is not a face of a"
            raise Fault(f"{text} {error.args[0]}", error.args[1]) from None
    return rows


def _nodes_of(part: _Part, name: str) -> list[int]:
    """Return the numbers of a node or of the nodes of a set."""
    if name.isdigit():
        return [int(name)]
    key = name.rpartition(".")[2].lower()
    if ("nodes", key) not in part.sets:
        raise Fault(f"*NODAL THICKNESS of '{shown(name)}', which is not defined")
    return [int(member) for member, _ in _flattened(part, "nodes", key, frozenset())]


def _solid_face(face: str, nodes: int) -> int:
    """Return the number from 0 of a face of a solid element; ``IndexError`` if it has fewer."""
    if (match := _FACE.fullmatch(face)) is None:
        raise ValueError("solid element", "Give faces as S1 to S6.")
    if int(match[1]) > (6 if nodes in (8, 20, 27) else 4):
        raise IndexError
    return int(match[1]) - 1


def _shell_edge(face: str, nodes: int) -> int:
    """Return the number from 0 of an edge of a shell element, below 0 for all of it; ``IndexError`` if it has fewer."""
    if face.upper() in _WHOLE:
        return _WHOLE[face.upper()]
    if (match := _EDGE.fullmatch(face)) is None:
        raise ValueError("shell element", "Give SPOS or SNEG, or edges as E1 to E4.")
    number = int(match[1]) - 1 if match[1] else int(match[2]) - 3
    if number >= (3 if nodes in (3, 6) else 4):
        raise IndexError
    return number


def _flattened(part: _Part, kind: str, key: str, above: frozenset[str]) -> Iterator[tuple[str, str]]:
    """Yield the members of a set, also of sets in it."""
    if key in above:
        raise Fault(f"set '{shown(part.names[kind, key])}' contains itself")
    for member, face in part.sets.get((kind, key), ()):
        if member.lstrip("+-").isdigit():
            yield member, face
            continue
        inner = "cells" if kind == "faces" else kind
        name = member.rpartition(".")[2].lower()
        if (inner, name) not in part.sets:
            raise Fault(f"set '{shown(part.names[kind, key])}' has '{shown(member)}', which is not defined")
        above_here = above | {key} if inner == kind else above
        yield from ((tag, face) for tag, _ in _flattened(part, inner, name, above_here))
