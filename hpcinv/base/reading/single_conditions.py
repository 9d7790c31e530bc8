"""Names of the regions of supports and loads that an input file gives node by node, or element by element.

The reader of the mesh makes sets of these names, and ``hpcinv new job --from`` finds them again.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import hypot, isfinite

type Forces = Mapping[int, tuple[float, float, float]]
type Held = Mapping[str, Mapping[int, float]]
type Pressed = Mapping[tuple[int, int], float]

AXES = ("x", "y", "z", "rx", "ry", "rz")
"""displacements and rotations, in the order of their numbers"""
_NAMED = {
    "ENCASTRE": AXES,
    "PINNED": ("x", "y", "z"),
    "XSYMM": ("x", "ry", "rz"),
    "YSYMM": ("y", "rx", "rz"),
    "ZSYMM": ("z", "rx", "ry"),
}
"""components that a named condition holds"""
_MOST = 20
"""Regions of one kind; more values are a field, which regions cannot have. Raised, files may have very many regions."""
_SAME = 3  # decimals of unit vectors that are the same direction


def held_groups(held: Held) -> Iterator[tuple[str, dict[str, float], frozenset[int]]]:
    """Yield name, displacements and nodes of the regions of conditions on nodes.

    Axes that are held at the same nodes by the same displacement have one region.

    Args:
        held: displacements by axis and node.
    """
    by_nodes: dict[tuple[float, frozenset[int]], list[str]] = {}
    for axis, values in held.items():
        groups: dict[float, list[int]] = {}
        for node, value in values.items():
            groups.setdefault(value, []).append(node)
        if len(groups) > _MOST:
            continue
        for value, nodes in groups.items():
            by_nodes.setdefault((value, frozenset(nodes)), []).append(axis)
    for (value, members), axes in by_nodes.items():
        name = f"held-{''.join(sorted(axes))}{f'={value:g}' if value else ''}"
        yield name, dict.fromkeys(axes, value), members


def force_groups(forces: Forces, called: str = "loaded") -> Iterator[tuple[str, frozenset[int]]]:
    """Yield name and nodes of the regions of forces on nodes: one for each direction; or of moments."""
    directions: dict[tuple[float, ...], list[int]] = {}
    for node, force in forces.items():
        if size := hypot(*force):
            directions.setdefault(tuple(round(part / size, _SAME) + 0.0 for part in force), []).append(node)
    if len(directions) <= _MOST:
        yield from _numbered(called, directions.values())


def pressed_groups(
    pressed: Pressed, called: str = "pressed"
) -> Iterator[tuple[str, float, frozenset[tuple[int, int]]]]:
    """Yield name, pressure, and elements with numbers of their faces of the regions of pressures on elements.

    Args:
        pressed: by element and number of the face, 0 for a shell; or loads on edges, by element and edge.
        called: beginning of the names.
    """
    values: dict[float, list[tuple[int, int]]] = {}
    for place, value in pressed.items():
        values.setdefault(value, []).append(place)
    if len(values) <= _MOST:
        names = _numbered(called, values.values())
        yield from ((name, value, places) for value, (name, places) in zip(values, names, strict=True))


def _numbered[Member](name: str, groups: Iterable[list[Member]]) -> Iterator[tuple[str, frozenset[Member]]]:
    every = list(groups)
    for number, group in enumerate(every, 1):
        yield (f"{name}-{number}" if len(every) > 1 else name), frozenset(group)


def held_axes(entries: Sequence[str], *, has_rotations: bool = False) -> dict[str, float]:
    """Return the displacements by axis of a line of ``*BOUNDARY``, after the node or set.

    Args:
        has_rotations: whether rotations about x, y and z are returned too, as ``rx``, ``ry`` and ``rz``.

    Raises:
        ValueError: these are neither numbers nor a named condition.
    """
    components = AXES if has_rotations else AXES[:3]
    if entries[0].upper() in _NAMED:
        return {name: 0.0 for name in _NAMED[entries[0].upper()] if name in components}
    first = last = fortran_number(entries[0])
    if len(entries) > 1 and entries[1]:
        last = fortran_number(entries[1])
    value = fortran_number(entries[2]) if len(entries) > 2 and entries[2] else 0.0
    return {name: value for place, name in enumerate(components, 1) if first <= place <= last}


def fortran_number(text: str) -> float:
    """Return a finite number, whose exponent may be Fortran's ``D``; raise ``ValueError`` for others."""
    value = float(text.upper().replace("D", "E"))
    if not isfinite(value):
        raise ValueError(f"{text!r} is not a number")
    return value
