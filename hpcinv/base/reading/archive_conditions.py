"""Supports and loads of archives of Ansys, by node and by face of an element: what holds at the end of the file.

A later command replaces an earlier one on the same node or face.
Source: *Ansys Mechanical APDL Command Reference*, ACEL, CE, CMSEL, D, F and SFE.
"""

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from math import hypot
from operator import mul
from typing import ClassVar, NamedTuple

from hpcinv.base.reading.element_faces import FACES, with_vertices
from hpcinv.base.reading.single_conditions import force_groups, fortran_number, held_groups, pressed_groups

type Vector = tuple[float, float, float]

_LABELS = {"UX": "x", "UY": "y", "UZ": "z"}
_FORCES = {"FX": 0, "FY": 1, "FZ": 2}
_FLAT = 1e-6
"""Difference of unit normals of one plane; raised, shallow curved faces are taken for planes."""
_MOST_PLANES = 20
"""More normals are of a curved face. Raised, files of such faces take longer."""
_RELEASE = re.compile(r"R\d+(\.\d+)?", re.IGNORECASE)
_ENTRIES = 11
"""of a command after its name; more are not read"""
BRICK = {1: 0, 2: 2, 3: 3, 4: 4, 5: 5, 6: 1}
TETRAHEDRON = {1: 0, 2: 1, 3: 2, 4: 3}
COLLAPSED = {1: 0, 2: 1, 3: 2, 5: 3}
"""Places in `FACES` by Ansys' numbers of faces: of a brick, of a tetrahedron, and of a brick with coinciding nodes."""


class Shape(NamedTuple):
    """Nodes of a solid element in the order of `FACES`, and places of its faces by their numbers in Ansys."""

    nodes: Sequence[int]
    faces: Mapping[int, int]


class HeldRegion(NamedTuple):
    """Nodes with known displacements by axis; a component, or nodes of no component under a name of their own."""

    name: str
    values: Mapping[str, float]
    nodes: frozenset[int]


class SlidingRegion(NamedTuple):
    """Nodes that stay in planes of one normal (3,): a component, some of whose nodes may be held along it by others."""

    name: str
    normal: Vector
    nodes: frozenset[int]


class ForceRegion(NamedTuple):
    """Nodes that bear forces of one load; its nodes may include unloaded vertices."""

    name: str | None
    nodes: frozenset[int]
    forces: Mapping[int, Vector]


class PressedRegion(NamedTuple):
    """Faces (element, place in `FACES`) with one pressure."""

    name: str
    pressure: float
    faces: frozenset[tuple[int, int]]


def _direction(terms: Sequence[Sequence[str]]) -> Vector | None:
    """Return the unit direction of a sum of (node, label, factor); ``None`` if the sum is zero."""
    parts = [0.0, 0.0, 0.0]
    for _, label, factor in terms:
        parts["xyz".index(_LABELS[label.upper()])] += fortran_number(factor or "1")
    x, y, z = parts
    size = hypot(x, y, z)
    return (x / size, y / size, z / size) if size else None


class Conditions:
    """Supports and loads.

    Args:
        sets: nodes and elements of components by ``nodes:NAME`` and ``cells:NAME``; components may follow.
        tags: numbers of all nodes.

    Attributes:
        held: displacements by axis and node.
        forces: components by node.
        pressed: pressures by element and Ansys' number of the face.
        equations: nodes, and unit directions along which they do not move.
        acceleration: of the frame, whose opposite acts on the body.
        damaged: commands with what is not a number.
        not_read: commands that are not read, and how many.
    """

    def __init__(self, sets: Mapping[str, Sequence[int]], tags: Sequence[int]) -> None:
        self.held: dict[str, dict[int, float]] = {}
        self.forces: dict[int, list[float]] = {}
        self.pressed: dict[tuple[int, int], float] = {}
        self.equations: list[tuple[int, Vector]] = []
        self.acceleration: Vector = (0.0, 0.0, 0.0)
        self.damaged: list[str] = []
        self.not_read = Counter[str]()
        self._sets, self._tags = sets, tags
        self._selected: Sequence[int] | None = tags  # None if it is not known

    def read(self, command: str, entries: Sequence[str], next_line: Callable[[], str]) -> None:
        """Read a command by its first four letters.

        Args:
            next_line: returns the line that follows.
        """
        try:
            self.READERS[command](self, [*entries, *[""] * _ENTRIES][:_ENTRIES], next_line)
        except ValueError as error:
            self.damaged.append(f"{command}: {error}")

    def _read_support(self, entries: Sequence[str], next_line: Callable[[], str]) -> None:
        given = [label.upper() for label in (entries[1], *entries[6:]) if label]
        labels = [own for label in given for own in (_LABELS if label == "ALL" else (label,))]
        nodes = self._nodes("D", entries[0], entries[4:6])
        value = fortran_number(entries[2] or "0")
        for label in labels:
            if label in _LABELS:
                self.held.setdefault(_LABELS[label], {}).update(dict.fromkeys(nodes, value))
            else:
                self.not_read[f"D,{label}"] += 1

    def _read_force(self, entries: Sequence[str], next_line: Callable[[], str]) -> None:
        label = entries[1].upper()
        if label not in _FORCES:
            self.not_read[f"F,{label}"] += 1
            return
        value = fortran_number(entries[2] or "0")
        for node in self._nodes("F", entries[0], entries[4:6]):
            self.forces.setdefault(node, [0.0, 0.0, 0.0])[_FORCES[label]] = value

    def _read_pressure(self, entries: Sequence[str], next_line: Callable[[], str]) -> None:
        values = next_line().split() if _RELEASE.fullmatch(entries[4]) else [v for v in entries[4:8] if v]
        label, name = entries[2].upper(), entries[0].upper()
        if label != "PRES":
            self.not_read[f"SFE,{label}"] += 1
            return
        elements = [int(name)] if name.isdigit() else self._members("cells", name)
        sizes = {fortran_number(value) for value in values}
        if not elements or entries[3] not in ("", "0", "1"):
            self.not_read[f"SFE,PRES of {name or 'no element'}"] += 1
            return
        if len(sizes) > 1:
            self.not_read["SFE,PRES that varies over a face"] += 1
            return
        key = int(fortran_number(entries[1] or "1"))
        self.pressed |= {(element, key): next(iter(sizes), 0.0) for element in elements}

    def _read_equation(self, entries: Sequence[str], next_line: Callable[[], str]) -> None:
        """Read a constraint equation of one node, without a constant."""
        terms = [entries[i : i + 3] for i in (2, 5, 8) if entries[i]]
        nodes, labels = {node for node, _, _ in terms}, [label.upper() for _, label, _ in terms]
        node = next(iter(nodes), "")
        has_number = entries[0].upper() == "NEXT" and len(nodes) == 1 and node.isdigit()
        if not has_number or not set(labels) <= _LABELS.keys() or fortran_number(entries[1] or "0"):
            self.not_read["CE"] += 1
            return
        if (direction := _direction(terms)) is not None:
            self.equations.append((int(node), direction))

    def _read_acceleration(self, entries: Sequence[str], next_line: Callable[[], str]) -> None:
        x, y, z = (fortran_number(entry or "0") for entry in entries[:3])
        self.acceleration = (x, y, z)

    def _read_selection(self, entries: Sequence[str], next_line: Callable[[], str]) -> None:
        """Read ``CMSEL``; a component of elements leaves the nodes."""
        nodes = self._members("nodes", entries[1])
        if entries[0].upper() not in ("", "S") or nodes is not None:
            self._selected = nodes if entries[0].upper() in ("", "S") else None

    def _read_node_selection(self, entries: Sequence[str], next_line: Callable[[], str]) -> None:
        self._selected = self._tags if entries[0].upper() == "ALL" else None

    def _select_all(self, entries: Sequence[str], next_line: Callable[[], str]) -> None:
        self._selected = self._tags

    def _nodes(self, command: str, text: str, span: Sequence[str]) -> Sequence[int]:
        """Return the nodes of a number with the end and step of a range, of a component, or of ``ALL``."""
        if text.isdigit():
            first, last, step = int(text), int(span[0] or text), int(span[1] or 1)
            if last - first > len(self._tags) * max(step, 1):
                raise ValueError(f"{last} ends a range beyond the nodes")
            return range(first, last + 1, max(step, 1))
        nodes = self._selected if text.upper() == "ALL" else self._members("nodes", text)
        if nodes is None:
            self.not_read[f"{command} of {text or 'no node'}"] += 1
        return nodes or ()

    def leave_out(self, rotated: Collection[int]) -> None:
        """Leave out what acts along the axes of nodes that are rotated; such axes are not read."""
        lost = set[int]()
        for values in self.held.values():
            clamped = {node for node in rotated if all(self.held.get(a, {}).get(node) == 0 for a in _LABELS.values())}
            lost |= (values.keys() & rotated) - clamped
        lost |= self.forces.keys() & rotated
        lost |= {node for node, _ in self.equations} & set(rotated)
        if not lost:
            return
        self.held = {axis: {n: v for n, v in own.items() if n not in lost} for axis, own in self.held.items()}
        self.forces = {node: force for node, force in self.forces.items() if node not in lost}
        self.equations = [equation for equation in self.equations if equation[0] not in lost]
        self.not_read["D, F and CE on nodes whose axes are rotated (NBLOCK)"] = len(lost)

    READERS: ClassVar[Mapping[str, Callable[["Conditions", Sequence[str], Callable[[], str]], None]]] = {
        "D": _read_support,
        "F": _read_force,
        "SFE": _read_pressure,
        "CE": _read_equation,
        "ACEL": _read_acceleration,
        "CMSE": _read_selection,
        "NSEL": _read_node_selection,
        "ALLS": _select_all,
    }

    def held_regions(self) -> Iterator[HeldRegion]:
        """Yield what is held: components all of whose nodes are, and then other nodes."""
        components, rest = self._components(), dict[str, dict[int, float]]()
        found: dict[str, dict[str, float]] = {}
        for axis, values in self.held.items():
            for value in dict.fromkeys(values.values()):
                left = nodes = frozenset(node for node, own in values.items() if own == value)
                for name, members in sorted(components.items(), key=lambda item: -len(item[1])):
                    if members <= nodes and members & left:
                        found.setdefault(name, {})[axis] = value
                        left -= members
                rest.setdefault(axis, {}).update(dict.fromkeys(left, value))
        yield from (HeldRegion(name, values, components[name]) for name, values in found.items())
        yield from (HeldRegion(*group) for group in held_groups(rest))

    def sliding_regions(self) -> Iterator[SlidingRegion]:
        """Yield planes in which the nodes of a component stay, by equations or since other supports hold them."""
        planes: list[tuple[Vector, set[int]]] = []
        for node, normal in self.equations:
            same = (nodes for other, nodes in planes if abs(abs(sum(map(mul, normal, other))) - 1) < _FLAT**2)
            if (nodes := next(same, None)) is None:
                planes.append((normal, nodes := set()))
                if len(planes) > _MOST_PLANES:
                    return
            nodes.add(node)
        components = sorted(self._components().items(), key=lambda item: len(item[1]))
        for normal, nodes in planes:
            axes = [axis for axis, part in zip("xyz", normal, strict=True) if abs(part) > _FLAT]
            for name, members in components:
                rest = members - nodes
                if members >= nodes and all(self.held.get(axis, {}).get(node) == 0 for node in rest for axis in axes):
                    yield SlidingRegion(name, normal, frozenset(nodes))
                    break

    def force_regions(self, shapes: Mapping[int, Shape]) -> Iterator[ForceRegion]:
        """Yield the forces of each load, on a component if it has the same nodes."""
        forces = {node: (x, y, z) for node, (x, y, z) in self.forces.items()}
        groups = dict(force_groups(forces))
        wide = with_vertices(groups, [shape.nodes for shape in shapes.values()])
        regions = {
            name: name if name in wide else next((other for other in wide if nodes <= wide[other]), None)
            for name, nodes in groups.items()
        }
        for region in dict.fromkeys(regions.values()):
            loaded = frozenset().union(*(groups[name] for name, own in regions.items() if own == region))
            nodes = wide.get(region or "", loaded)
            name = next((name for name, members in self._components().items() if members == nodes), region)
            yield ForceRegion(name, nodes, {node: forces[node] for node in sorted(loaded)})

    def pressed_regions(self, shapes: Mapping[int, Shape]) -> Iterator[PressedRegion]:
        """Yield the faces of each pressure, under the name of a component that has the same vertices."""
        vertices = {tag: _vertices(shape) for tag, shape in shapes.items()}
        every = frozenset().union(*vertices.values())
        components = {name: members & every for name, members in self._components().items()}
        pressed = {
            (element, shapes[element].faces[key]): value
            for (element, key), value in self.pressed.items()
            if value and element in shapes and key in shapes[element].faces
        }
        for name, pressure, faces in pressed_groups(pressed):
            own = frozenset(vertices[e][i] for e, face in faces for i in FACES[len(vertices[e])][face])
            called = next((other for other, members in components.items() if members == own), name)
            yield PressedRegion(called, pressure, faces)

    def lost_pressures(self, shapes: Mapping[int, Shape]) -> int:
        """Return the number of pressures on what is not a face of a solid element."""
        places = [place for place, value in self.pressed.items() if value]
        return sum(element not in shapes or key not in shapes[element].faces for element, key in places)

    def _members(self, kind: str, name: str) -> Sequence[int] | None:
        """Return the members of a component, whose name may have letters of either case."""
        wanted = f"{kind}:{name}".upper()
        return next((members for key, members in self._sets.items() if key.upper() == wanted), None)

    def _components(self) -> dict[str, frozenset[int]]:
        """Return the nodes of each component that has nodes, by its name."""
        return {key[6:]: frozenset(members) for key, members in self._sets.items() if key.startswith("nodes:")}


def _vertices(shape: Shape) -> tuple[int, ...]:
    return tuple(shape.nodes[: 4 if len(shape.nodes) in (4, 10) else 8])


CONDITIONS = frozenset(Conditions.READERS)
"""commands that `Conditions.read` reads, by their first four letters"""
