"""Parts of input files of Abaqus and CalculiX: their nodes, elements and sets, and where an assembly places them."""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hpcinv.base.reading.abaqus_keywords import Keyword
from hpcinv.base.reading.coordinate_frames import rotation
from hpcinv.base.reading.fault import Fault, shown

_FACE = re.compile(r"S([1-6])", re.IGNORECASE)
_EDGE = re.compile(r"(?:E|EDGE)([1-4])|S([3-6])", re.IGNORECASE)
"""edge of a shell: Abaqus' E1, E2, …, CalculiX' S3, S4, …"""
_WHOLE = {"": -1, "SNEG": -1, "S1": -1, "SPOS": -2, "S2": -2}
"""a whole shell element, whose side along its normal is SPOS"""
OF_CELLS = "nodes of elements"  # marks a member of a node set that is a set of elements
NODE_SURFACE = "node surface"  # kind of surfaces by nodes, whose names are apart from names of node sets
INSTANCE = "instance "  # begins the name of a part that holds the sets of an instance
OWN_MESH = "mesh of instance "  # begins the name of a part that holds what is within an instance
GENERATED = "generated"  # marks members of a generated set, whose range may have numbers that are not defined


@dataclass(eq=False)
class Part:
    """Nodes, elements and sets of a part, or of a file without parts; sets by their names in lower case."""

    nodes: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    elements: dict[int, list[int]] = field(default_factory=dict)
    others: set[int] = field(default_factory=set)  # elements that are not solids
    names: dict[tuple[str, str], str] = field(default_factory=dict)
    sets: dict[tuple[str, str], list[tuple[str, str]]] = field(default_factory=dict)
    shared: set[tuple[str, str]] = field(default_factory=set)  # of the assembly, which other instances may have too
    thickness: list[tuple[list[str], str]] = field(default_factory=list)  # rows of *NODAL THICKNESS, and their places

    def members(self, kind: str, name: str) -> list[tuple[str, str]]:
        """Return the members of a set, which may be new: names or numbers, with faces or marks."""
        key = kind, name.lower()
        self.names.setdefault(key, name)
        return self.sets.setdefault(key, [])


def placed_parts(parts: Mapping[str, Part], instances: list[Keyword]) -> list[tuple[Part, Callable[[Any], Any], str]]:
    """Return the part of each instance with the sets of the assembly in it, its motion, and its name."""
    placed = []
    for card in instances:
        instance = card.options.get("NAME", needed(card, "PART"))
        placed.append((_part_of(card, instance, parts), _motion(card), instance))
    outside = parts[""]
    for key, spelled in outside.names.items() if instances else ():
        members = outside.sets[key]
        numbers = {int(member) for member, _ in members if member.isdigit()}
        if len(instances) > 1 and numbers - (outside.nodes.keys() if key[0] != "cells" else set()):
            raise Fault(f"set '{shown(spelled)}' of the assembly has numbers without instance=", "Name the instance.")
        for name, face in {member.lower(): face for member, face in members if not member.isdigit()}.items():
            _drop_where_missing([own for own, _, _ in placed], key, (_inner_kind(key[0], face), name), spelled)
    return placed


def _drop_where_missing(owns: list[Part], key: tuple[str, str], inner: tuple[str, str], spelled: str) -> None:
    """Leave a set out of another in the parts that do not have it; ``Fault`` if none has."""
    without = [own for own in owns if inner not in own.sets]
    if len(without) == len(owns):
        raise Fault(f"set '{shown(spelled)}' has '{shown(inner[1])}', which is not defined")
    for own in without:
        own.sets[key] = [entry for entry in own.sets[key] if entry[0].lower() != inner[1]]


def _part_of(card: Keyword, instance: str, parts: Mapping[str, Part]) -> Part:
    """Return the part of an instance, with the sets that the assembly has of it."""
    outside, name = parts[""], needed(card, "PART")
    part = parts.get(name.lower())
    if part is None:
        raise Fault(f"{card.place}: there is no part '{shown(name)}'")
    content = parts.get(f"{OWN_MESH}{instance.lower()}", Part())
    if content.nodes:  # of Abaqus/CAE's independent instances
        part, content = content, Part()
    sets = {key: [*members] for key, members in part.sets.items()}
    own = Part(part.nodes, part.elements, part.others, dict(part.names), sets, thickness=part.thickness)
    for more in (content, parts.get(f"{INSTANCE}{instance.lower()}", Part()), outside):
        for key, spelled in more.names.items():
            members = more.sets[key]
            if more is outside and key[0] in ("nodes", NODE_SURFACE):  # its own nodes are reference points
                members = [m for m in members if not (m[0].isdigit() and int(m[0]) in outside.nodes)]
            own.members(key[0], spelled).extend(members)
            own.shared.add(key)
    return own


def at_place(position: Any) -> Any:
    """Return a position that is not moved."""
    return np.array(position)


def _motion(card: Keyword) -> Callable[[Any], Any]:
    """Return the motion of an instance: it is moved, then turned about the axis between two points, by degrees."""
    shift, turn = ([floats(row, place) for place, row in card.rows] + [[], []])[:2]
    move = np.array([*shift, 0.0, 0.0, 0.0][:3])
    if not turn:
        return lambda position: np.add(position, move)
    if len(turn) != 7 or len(card.rows) > 2 or turn[:3] == turn[3:6]:
        text = f"{card.place}: the instance is turned by other than two points of an axis and an angle"
        raise Fault(text, "Save the mesh in global coordinates.")
    start, axis = np.array(turn[:3]), np.subtract(turn[3:6], turn[:3])
    matrix = rotation(axis / np.linalg.norm(axis), math.radians(turn[6]))
    return lambda position: start + matrix @ (np.add(position, move) - start)


def _inner_kind(kind: str, face: str) -> str:
    """Return the kind of sets that a set or surface may have as a member."""
    return "cells" if kind == "faces" or face == OF_CELLS else "nodes" if kind == NODE_SURFACE else kind


def needed(card: Keyword, option: str) -> str:
    """Return the value of an option; ``Fault`` without one."""
    if not (value := card.options.get(option, "")):
        raise Fault(f"{card.place}: *{card.name} needs {option}=")
    return value


def floats(row: list[str], place: str) -> list[float]:
    """Return numbers; entries that are left out are 0."""
    try:
        values = [float((entry or "0").lower().replace("d", "e")) for entry in row]
    except ValueError:
        raise Fault(f"{place}: '{shown(', '.join(row))}' are not numbers") from None
    if not np.isfinite(values).all():
        raise Fault(f"{place}: has a number that is not finite")
    return values


def whole_tags(row: list[str], place: str) -> list[int]:
    """Return whole numbers."""
    try:
        return [int(entry) for entry in row]
    except ValueError:
        raise Fault(f"{place}: '{shown(', '.join(row))}' are not whole numbers") from None


def rows_of_set(
    part: Part,
    kind: str,
    key: str,
    node_row: Mapping[int, int],
    cell_row: Mapping[int, int],
    cells: list[list[int]],
    number_of_face: Callable[[str, int], int],
) -> list[Any]:
    """Return rows of the members of a set; pairs of a cell and a face for a surface."""
    rows: list[Any] = []
    is_of_nodes = kind in ("nodes", NODE_SURFACE)
    numbers = node_row if is_of_nodes else cell_row
    for member, face in _flattened(part, kind, key, frozenset()):
        tag = int(member)
        if not is_of_nodes and tag in part.others:
            continue
        if tag not in numbers and face == GENERATED:
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


def nodes_of(part: Part, name: str) -> list[int]:
    """Return the numbers of a node or of the nodes of a set."""
    if name.isdigit():
        return [int(name)]
    key = name.rpartition(".")[2].lower()
    if ("nodes", key) not in part.sets:
        raise Fault(f"*NODAL THICKNESS of '{shown(name)}', which is not defined")
    return [int(member) for member, _ in _flattened(part, "nodes", key, frozenset())]


def solid_face(face: str, nodes: int) -> int:
    """Return the number from 0 of a face of a solid element; ``IndexError`` if it has fewer."""
    if (match := _FACE.fullmatch(face)) is None:
        raise ValueError("solid element", "Give faces as S1 to S6.")
    if int(match[1]) > (6 if nodes in (8, 20, 27) else 4):
        raise IndexError
    return int(match[1]) - 1


def shell_edge(face: str, nodes: int) -> int:
    """Return the number from 0 of an edge of a shell element, below 0 for all of it; ``IndexError`` if it has fewer."""
    if face.upper() in _WHOLE:
        return _WHOLE[face.upper()]
    if (match := _EDGE.fullmatch(face)) is None:
        raise ValueError("shell element", "Give SPOS or SNEG, or edges as E1 to E4.")
    number = int(match[1]) - 1 if match[1] else int(match[2]) - 3
    if number >= (3 if nodes in (3, 6) else 4):
        raise IndexError
    return number


def _flattened(part: Part, kind: str, key: str, above: frozenset[str]) -> Iterator[tuple[str, str]]:
    """Yield the members of a set, also of sets in it."""
    if key in above:
        raise Fault(f"set '{shown(part.names[kind, key])}' contains itself")
    for member, face in part.sets.get((kind, key), ()):
        if member.lstrip("+-").isdigit() and face != OF_CELLS:
            yield member, face
            continue
        inner = _inner_kind(kind, face)
        name = member.rpartition(".")[2].lower()
        if (inner, name) not in part.sets:
            raise Fault(f"set '{shown(part.names[kind, key])}' has '{shown(member)}', which is not defined")
        above_here = above | {key} if inner == kind else above
        tags = (tag for tag, _ in _flattened(part, inner, name, above_here))
        if face == OF_CELLS:
            yield from ((str(node), "") for tag in tags for node in part.elements.get(int(tag), ()))
        else:
            yield from ((tag, face) for tag in tags)
