"""Input files of Abaqus and CalculiX (``.inp``): nodes, solid elements, sets and surfaces by element faces.

Numbers of nodes and elements are unique within a part. A part that has several instances is read once for each.
Sources: *Abaqus Keywords Guide*; Dhondt, *CalculiX CrunchiX User's Manual*, "Element types".
"""

import contextlib
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from hpcinv.base.reading.abaqus_keywords import Keyword, keywords, position_of
from hpcinv.base.reading.abaqus_options import USED, not_used, remedy
from hpcinv.base.reading.abaqus_parts import (
    GENERATED,
    INSTANCE,
    NODE_SURFACE,
    OF_CELLS,
    OWN_MESH,
    Part,
    at_place,
    floats,
    needed,
    nodes_of,
    placed_parts,
    rows_of_set,
    shell_edge,
    solid_face,
    whole_tags,
)
from hpcinv.base.reading.element_faces import with_vertices
from hpcinv.base.reading.fault import Fault, shown
from hpcinv.base.reading.included_files import lines_of
from hpcinv.base.reading.numbered_elements import integers
from hpcinv.base.reading.single_conditions import force_groups, held_groups, pressed_groups
from hpcinv.base.reading.standing_conditions import (
    EDGE_LOAD,
    PRESSED,
    NewConditions,
    SingleConditions,
    Standing,
    by_axis,
    vectors,
)

_SOLID = re.compile(r"C3D(4|10|8|20|27)[A-Z]*")
_NOT_SOLID = re.compile(
    r"(?:CPS|CPE|CAX|S|STRI|M3D|SFM3D|R3D|DS|T[23]D|B3|C1D|MASS|ROTARYI|DASHPOT|GAP|DCOUP|CONN)\w*|D", re.ASCII
)
_STIFF = re.compile(r"(?:S|STRI|M3D|B3|SPRING|DASHPOT|MASS|ROTARYI|GAP|CONN|DCOUP)\w*", re.ASCII)
"""those that bear loads or have mass, unlike the surface elements of mesh programs"""
_DATA = re.compile(r"[-+.,\s\deEdD]+")
"""a line of numbers, whose keyword is lost if it is the first one"""
_THICKNESS = "values:nodal_thickness"
_WITH_END = ("PART", "INSTANCE", "ASSEMBLY", "STEP")
_OF_JOBS = {*USED}  # keywords that a job may have, and a mesh has not
_MOST_GENERATED = 10_000_000  # members of a generated set; more are a damaged line


class _Solids:
    """Solid elements, and the base of others that are read instead."""

    types: ClassVar[re.Pattern[str]] = _SOLID
    has_rotations: ClassVar[bool] = False

    def face(self, name: str, nodes: int) -> int:
        """Return the number of a face of an element; raise ``IndexError`` if it has fewer."""
        return solid_face(name, nodes)

    def check_other(self, place: str, kind: str) -> None:
        """Raise `Fault` for elements of another kind that these cannot stand next to."""

    def lacking(self, part: Part) -> Fault:
        """Return the fault of a part without these elements."""
        remedy = " For shell elements give 'mesh: {shell: {thickness: …}}'." if part.others else ""
        text = f"Elements are C3D4, C3D10, C3D8, C3D20 and C3D27, also with H, R, I or M.{remedy}"
        return Fault("has no solid elements", text)

    def thickness(self, parts: Sequence[Part]) -> dict[str, Any]:
        """Return an array of the thickness at the nodes of some parts, if they have one."""
        for part in parts:
            _thickness(part)  # damaged lines are faults
        return {}


class _Shells(_Solids):
    """Elements of shells and membranes."""

    types: ClassVar[re.Pattern[str]] = re.compile(r"(?:S|STRI|M3D)(3|4|6|8|9)[A-Z0-9]*", re.ASCII)
    has_rotations: ClassVar[bool] = True

    def face(self, name: str, nodes: int) -> int:
        return shell_edge(name, nodes)

    def check_other(self, place: str, kind: str) -> None:
        if _SOLID.fullmatch(kind):
            text = f"{place}: a shell cannot be tied to solid elements, such as {shown(kind)}"
            raise Fault(text, "Save the surface alone, or mesh all of it as a solid.")

    def lacking(self, part: Part) -> Fault:
        text = "Elements of shells are S3, S4, S6, S8 and S9, also with R. Leave 'shell' out for a solid."
        return Fault("has no shell elements", text)

    def thickness(self, parts: Sequence[Part]) -> dict[str, Any]:
        if not any(part.thickness for part in parts):
            return {}
        return {_THICKNESS: np.array([value for part in parts for value in _thickness(part)])}


@dataclass
class _Conditions:
    """Supports and loads of single nodes and elements, and faces of element sets that a line of ``*DLOAD`` names."""

    single: SingleConditions
    step: int = 0
    new: NewConditions = field(default_factory=NewConditions)
    pressed: dict[tuple[str, str, str], None] = field(default_factory=dict)  # region, set and face

    def read(self, card: Keyword) -> None:
        """Read supports or loads; damaged lines are reported elsewhere."""
        if self.new.ends_earlier(card.name, card.options, self.step):
            self.single.end_earlier(card.name, self.step)
        for row in card.lines:
            with contextlib.suppress(ValueError):
                self.single.read(card.name, row, self.step)
            if card.name != "DLOAD" or len(row) < 2 or row[0].isdigit():
                continue
            if (match := PRESSED.fullmatch(row[1])) and match[1]:
                self.pressed[f"{row[0]}-P{match[1]}", row[0], f"S{match[1]}"] = None
            elif match := EDGE_LOAD.fullmatch(row[1]):
                self.pressed[f"{row[0]}-EDNOR{match[1]}", row[0], f"E{match[1]}"] = None

    def add_sets(self, part: Part, *, has_rotations: bool) -> None:
        """Add a set for each of their regions, of what is defined, if the file has no set of its name."""
        for region, name, face in self.pressed:
            if ("cells", name.lower()) in part.sets:  # not of other elements
                part.members("faces", region).append((name, face))
        for name, members in self._nodes(part, has_rotations=has_rotations).items():
            if ("nodes", name) not in part.sets:
                part.members("nodes", name).extend((str(node), "") for node in sorted(members & part.nodes.keys()))
        for name, faces in (
            *_faces(self.single.pressed, "pressed", "S"),
            *_faces(self.single.edges, "edge-loaded", "E"),
        ):
            if ("faces", name) not in part.sets:
                part.members("faces", name).extend((str(e), face) for e, face in faces if e in part.elements)

    def _nodes(self, part: Part, *, has_rotations: bool) -> dict[str, frozenset[int]]:
        """Return nodes that are held or loaded alike, by the name of their set."""
        single = self.single
        nodes = {name: nodes for name, _, nodes in held_groups(by_axis(single.held))}
        nodes |= with_vertices(dict(force_groups(vectors(single.forces, is_scaled=False))), part.elements.values())
        if has_rotations:
            nodes |= dict(force_groups(vectors(single.moments, is_scaled=False), "turned"))
        return nodes


def _faces(
    standing: Standing[tuple[int, int]], called: str, letter: str
) -> Iterator[tuple[str, list[tuple[int, str]]]]:
    """Yield the name of each set of faces or edges that are loaded alike, and elements with names of their faces."""
    for name, _, places in pressed_groups({place: value.raw for place, value in standing.values.items()}, called):
        yield name, [(element, f"{letter}{face}" if face else "") for element, face in sorted(places)]


def read_inp(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the keywords that are not used, and arrays: nodes, elements and sets.

    Arrays are ``points`` (n, 3), ``node_tags`` (n,), ``cells`` (m, k) in the order of the file, ``cell_tags`` (m,),
    ``cells:NAME`` and ``nodes:NAME`` (rows of the members of a set), ``faces:NAME`` (cell, number of the face from 0).
    """
    head, arrays, cells = _content(path, _Solids())
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
    head, arrays, cells = _content(path, _Shells())
    offsets, connectivity = np.cumsum([0, *map(len, cells)]), np.concatenate(cells).astype(np.int64)
    if (thickness := arrays.get(_THICKNESS)) is not None:  # nodes without cells need none
        known = thickness[connectivity]
        unused = np.setdiff1d(np.arange(len(thickness)), connectivity)
        thickness[unused] = known[np.isfinite(known)].mean() if np.isfinite(known).any() else np.nan
    return head, arrays | {"offsets": offsets, "connectivity": connectivity}


def _content(path: Path, kind: _Solids) -> tuple[dict[str, Any], dict[str, Any], list[list[int]]]:
    """Return what `read_inp` does, and the nodes of the elements of a kind apart."""
    file = _FileReader(path, kind)
    file.read()
    placed = placed_parts(file.parts, file.instances) or [(file.parts[""], at_place, "")]
    assembly = _Assembly(kind.face)
    for part, moved, name in placed:
        if not part.elements:
            raise kind.lacking(part)
        assembly.add(part, moved, name if len(placed) > 1 else "")
    arrays = assembly.arrays(are_numbered_again=len(placed) > 1) | kind.thickness([part for part, _, _ in placed])
    return {"ignored": sorted(file.ignored)}, arrays, assembly.cells


class _Assembly:
    """Nodes, elements and sets of all parts.

    Args:
        face: number of a face by its name and the number of nodes of its element.
    """

    def __init__(self, face: Callable[[str, int], int]) -> None:
        self.cells: list[list[int]] = []
        self._face = face
        self._points: list[Any] = []
        self._tags: list[int] = []
        self._cell_tags: list[int] = []
        self._sets: dict[str, list[Any]] = {}

    def add(self, part: Part, moved: Callable[[Any], Any], instance: str) -> None:
        """Add a part, whose own sets begin with the name of the instance if it has one."""
        node_row = {tag: len(self._points) + i for i, tag in enumerate(part.nodes)}
        cell_row = {tag: len(self.cells) + i for i, tag in enumerate(part.elements)}
        self._points += [moved(position) for position in part.nodes.values()]
        self._tags += part.nodes
        self._cell_tags += part.elements
        self.cells += _cells(part, node_row)
        for kind, key in part.names:
            if rows := rows_of_set(part, kind, key, node_row, cell_row, self.cells, self._face):
                self._sets.setdefault(_name_of_set(part, kind, key, instance), []).extend(rows)

    def arrays(self, *, are_numbered_again: bool) -> dict[str, Any]:
        """Return the arrays without the cells; numbers of several instances repeat, and become places."""
        tags, cell_tags = self._tags, self._cell_tags
        if are_numbered_again:
            tags, cell_tags = list(range(1, len(tags) + 1)), list(range(1, len(cell_tags) + 1))
        arrays: dict[str, Any] = {
            "points": np.array(self._points),
            "node_tags": integers(tags, "numbers of nodes"),
            "cell_tags": integers(cell_tags, "numbers of elements"),
        }
        return arrays | {n: np.unique(np.array(rows, dtype=np.int64), axis=0) for n, rows in self._sets.items()}


def _cells(part: Part, node_row: dict[int, int]) -> list[list[int]]:
    """Return the rows of the nodes of each element."""
    for tag, nodes in part.elements.items():
        if missing := [node for node in nodes if node not in node_row]:
            raise Fault(f"element {tag} has node {missing[0]}, which is not defined")
    return [[node_row[node] for node in nodes] for nodes in part.elements.values()]


def _name_of_set(part: Part, kind: str, key: str, instance: str) -> str:
    """Return the name of the array of a set; instances of a part have their own ones, but of shared sets."""
    prefix = f"{instance}." if instance and (kind, key) not in part.shared else ""
    called = f"{prefix}{part.names[kind, key]}"
    if kind != NODE_SURFACE:
        return f"{kind}:{called}"
    return f"nodes:{called}" + ("-surface" if ("nodes", key) in part.names else "")


def _thickness(part: Part) -> list[float]:
    """Return the thickness at the nodes of a part; not a number where it has none."""
    values = dict.fromkeys(part.nodes, math.nan)
    for row, place in part.thickness:
        (value,) = floats([*row[1:2], ""][:1], place)
        values |= {tag: value for tag in nodes_of(part, row[0]) if tag in values}
    return list(values.values())


class _FileReader:
    """Reads the keywords of a file in order.

    Attributes:
        parts: by lower-case name; outside of parts, and of an assembly, ``""``.
        instances: keywords that place a part.
        ignored: what is not used.
    """

    def __init__(self, path: Path, kind: _Solids) -> None:
        self.parts: dict[str, Part] = {"": Part()}
        self.instances: list[Keyword] = []
        self.ignored: set[str] = set()
        self._path, self._kind = path, kind
        self._current = self.parts[""]
        self._conditions = _Conditions(SingleConditions(has_rotations=kind.has_rotations))
        self._open: dict[str, str] = {}  # places of keywords whose end is missing

    def read(self) -> None:
        """Read all keywords."""
        for card in _cards(self._path):
            if refused := remedy(card.name, card.options):
                raise Fault(f"{card.place}: *{card.name}, {refused[0]} is not read", refused[1])
            self._note_ends(card)
            if reader := self._READERS.get(card.name):
                reader(self, card)
                self.ignored.update(not_used(card.name, card.options))
            elif not card.name:
                self.ignored.add(f"{len(card.rows):,} lines before the first keyword")
            elif card.name not in _OF_JOBS:
                self.ignored.update(text.removeprefix("*") for text in not_used(card.name, ()))
            else:
                self.ignored.add(card.name)
        for name, place in self._open.items():
            raise Fault(f"{place}: *{name} has no *END {name}", "Is the file complete?")
        outside = self.parts[""]
        if not self.parts.keys() - {""}:
            self._conditions.add_sets(outside, has_rotations=self._kind.has_rotations)
        self._check_parts()

    def _note_ends(self, card: Keyword) -> None:
        if card.name in _WITH_END:
            self._open[card.name] = card.place
        elif card.name.startswith("END "):
            self._open.pop(card.name.removeprefix("END "), None)

    def _check_parts(self) -> None:
        parts, outside = self.parts, self.parts[""]
        named = [part for name, part in parts.items() if name]
        if self.instances and outside.elements:
            raise Fault("has elements outside of its parts", "Save one part, or the assembly with its parts.")
        if self.instances and outside.nodes:
            self.ignored.add(f"{len(outside.nodes):,} reference points")
        elif not self.instances and len(named) == 1:
            parts[""] = named[0]
        elif not self.instances and named:
            raise Fault(f"has {len(named)} parts and no assembly", "Save one part, or the assembly with its instances.")

    def _begin_part(self, card: Keyword) -> None:
        self._current = self.parts.setdefault(needed(card, "NAME").lower(), Part())

    def _begin_instance(self, card: Keyword) -> None:
        self.instances.append(card)
        name = card.options.get("NAME", needed(card, "PART"))
        self._current = self.parts.setdefault(f"{OWN_MESH}{name.lower()}", Part())

    def _leave(self, card: Keyword) -> None:
        self._current = self.parts[""]

    def _read_nodes(self, card: Keyword) -> None:
        if _read_nodes(self._current, card):
            self.ignored.add("normals of nodes")

    def _read_elements(self, card: Keyword) -> None:
        self.ignored.update(_read_elements(self._current, card, self._kind))

    def _owner(self, card: Keyword) -> Part:
        """Return the part that a set is of."""
        instance = card.options.get("INSTANCE")
        if not instance:
            return self._current
        if instance.lower() not in {known.options.get("NAME", "").lower() for known in self.instances}:
            raise Fault(f"{card.place}: there is no instance '{shown(instance)}'")
        return self.parts.setdefault(f"{INSTANCE}{instance.lower()}", Part())

    def _read_set(self, card: Keyword) -> None:
        kind = "nodes" if card.name == "NSET" else "cells"
        name = needed(card, card.name)
        if kind == "nodes" and "ELSET" in card.options:  # the nodes of its elements
            self._owner(card).members(kind, name).append((needed(card, "ELSET"), OF_CELLS))
        else:
            _read_set(self._owner(card), kind, name, card)

    def _read_surface(self, card: Keyword) -> None:
        kind = {"ELEMENT": "faces", "NODE": NODE_SURFACE}.get(card.options.get("TYPE", "ELEMENT").upper(), "")
        if not kind:
            self.ignored.add(f"SURFACE, TYPE={shown(card.options['TYPE'])}")
            return
        members = self._current.members(kind, needed(card, "NAME"))
        members += [(row[0], row[1] if len(row) > 1 and kind == "faces" else "") for row in card.lines if row[0]]

    def _read_conditions(self, card: Keyword) -> None:
        self.ignored.add(card.name)
        self._conditions.read(card)

    def _read_step(self, card: Keyword) -> None:
        self.ignored.add(card.name)
        self._conditions.step += 1

    def _read_thickness(self, card: Keyword) -> None:
        self.ignored.add(card.name)
        self._current.thickness += [(row, place) for place, row in card.rows]

    def _refuse(self, card: Keyword) -> None:
        text = f"{card.place}: *{card.name} is not read"
        raise Fault(text, "Save the mesh with all its nodes and elements in global coordinates.")

    _READERS: ClassVar[Mapping[str, Callable[[Any, Keyword], None]]] = {
        "PART": _begin_part,
        "END PART": _leave,
        "INSTANCE": _begin_instance,
        "END INSTANCE": _leave,
        "NODE": _read_nodes,
        "ELEMENT": _read_elements,
        "NSET": _read_set,
        "ELSET": _read_set,
        "SURFACE": _read_surface,
        "DLOAD": _read_conditions,
        "BOUNDARY": _read_conditions,
        "CLOAD": _read_conditions,
        "STEP": _read_step,
        "NODAL THICKNESS": _read_thickness,
        **dict.fromkeys(("SYSTEM", "NGEN", "NFILL", "NMAP", "ELGEN", "NCOPY", "ELCOPY", "PARAMETER"), _refuse),
    }


def _cards(path: Path) -> Iterator[Keyword]:
    """Yield the keywords; text before the first one, which CalculiX leaves out, has none."""
    is_empty = True
    for card in keywords(lines_of(path)):
        for place, row in () if card.name else card.rows:
            if _DATA.fullmatch(",".join(row)):
                raise Fault(f"{place} is not a keyword", "Input files begin with a keyword such as *NODE.")
        is_empty = is_empty and not card.name
        yield card
    if is_empty:
        raise Fault("has no keywords", "Is it an input file of Abaqus or CalculiX?")


def _read_nodes(part: Part, card: Keyword) -> bool:
    """Read nodes, in the coordinates of the keyword; return whether they have normals."""
    group = part.members("nodes", card.options["NSET"]) if card.options.get("NSET") else []
    has_normals = False
    for place, row in card.rows:
        (tag,) = whole_tags(row[:1], place)
        if len(row) < 2:
            raise Fault(f"{place}: a node has no coordinates")
        part.nodes[tag] = position_of(floats(row[1:4], place), card.options.get("SYSTEM", ""), place)
        has_normals = has_normals or len(row) > 4
        group.append((str(tag), ""))
    return has_normals


def _read_elements(part: Part, card: Keyword, read: _Solids) -> list[str]:
    """Read the elements of a keyword; return what is ignored.

    As CalculiX does, entries after the last node of an element are ignored. They are faults if lines differ in length:
    then they may be nodes of another type of elements.
    """
    kind = needed(card, "TYPE").upper()
    match = read.types.fullmatch(kind)
    if match is None:
        return _note_others(part, card, kind, read)
    count = int(match[1])
    group = part.members("cells", card.options["ELSET"]) if card.options.get("ELSET") else []
    pending: list[int] = []
    length = len(card.rows[0][1]) if len({len(row) for _, row in card.rows}) == 1 else 0
    is_longer = length > count + 1
    for place, row in card.rows:
        pending += whole_tags(row, place)[: count + 1 if is_longer else None]
        if len(pending) < count + 1:
            continue
        if len(pending) > count + 1:
            raise Fault(f"{place}: an element {shown(kind)} has {count} nodes, not {len(pending) - 1}")
        if pending[0] in part.elements:
            raise Fault(f"{place}: element {pending[0]} is defined twice", "Number the elements again.")
        part.elements[pending[0]] = pending[1:]
        group.append((str(pending[0]), ""))
        pending = []
    if pending:
        raise Fault(f"{card.rows[-1][0]}: element {pending[0]} has {len(pending) - 1} nodes, not {count}")
    return [f"entries after the {count} nodes of elements {shown(kind)}"] if is_longer else []


def _note_others(part: Part, card: Keyword, kind: str, read: _Solids) -> list[str]:
    """Note elements of another kind, such as springs, masses and surfaces of mesh programs; return what is ignored."""
    read.check_other(card.place, kind)
    if not _NOT_SOLID.fullmatch(kind):
        text = f"{card.place}: elements {shown(kind)} are not supported"
        raise Fault(text, "Use C3D4, C3D10, C3D8, C3D20 or C3D27, also with H, R, I or M.")
    tags = [whole_tags(row[:1], place)[0] for place, row in card.rows if row[0]]
    part.others.update(tags)
    if card.options.get("ELSET"):
        part.members("cells", card.options["ELSET"]).extend((str(tag), "") for tag in tags)
    return [f"elements {shown(kind)}"] if _STIFF.fullmatch(kind) else []


def _read_set(part: Part, kind: str, name: str, card: Keyword) -> None:
    members = part.members(kind, name)
    for place, row in card.rows:
        if "GENERATE" not in card.options:
            members += [(entry, "") for entry in row if entry]
            continue
        numbers = whole_tags([entry for entry in row if entry], place)
        first, last, step = (*numbers, 1)[:3] if len(numbers) in (2, 3) else (1, 0, 1)
        if not step or not 0 < (last - first) // step + 1 <= _MOST_GENERATED:
            raise Fault(f"{place}: the generated set has no valid range")
        members += [(str(tag), GENERATED) for tag in range(first, last + (1 if step > 0 else -1), step)]
