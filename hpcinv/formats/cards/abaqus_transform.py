"""``*TRANSFORM`` of Abaqus and CalculiX: axes of the components of supports and forces at nodes.

Source: *Abaqus Keywords Guide*, ``*TRANSFORM``; Dhondt, *CalculiX CrunchiX User's Manual*, ``*TRANSFORM``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from hpcinv.base.quantity.arrays import Floats
from hpcinv.base.reading.abaqus_keywords import Keyword
from hpcinv.formats.cards.abaqus_axes import frame_at
from hpcinv.formats.cards.card import CardError, number

_PARALLEL = 1e-9
"""difference of unit vectors of the same axis; raised, oblique axes are taken for axes of the coordinates"""


@dataclass(frozen=True)
class TransformAxes:
    """Axes (3, 3), as rows; of a cylindrical one only the third is known, and the others depend on the place."""

    axes: tuple[tuple[float, ...], ...]
    is_cylindrical: bool = False

    def force(self, components: tuple[float, ...]) -> tuple[float, float, float] | None:
        """Return the global components of a force; ``None`` if they depend on the place."""
        if self.is_cylindrical and any(components[:2]):
            return None
        x, y, z = (np.array(components) @ np.array(self.axes) + 0.0).tolist()
        return x, y, z

    def supports(self, values: Mapping[str, float]) -> tuple[dict[str, float], list[float]] | None:
        """Return global displacements, and a normal along which nothing moves; ``None`` if these cannot say it.

        Args:
            values: displacements along the own axes, by ``x``, ``y`` and ``z``.
        """
        held = [values.get(axis) for axis in "xyz"]
        is_varying = self.is_cylindrical and (len({"x", "y"} & values.keys()) == 1 or held[0] or held[1])
        if is_varying:
            return None
        axes: Floats = np.array(self.axes)
        if None not in held:
            vector = np.array(held, dtype=np.float64) @ axes + 0.0
            return dict(zip("xyz", vector.tolist(), strict=True)), []
        displacements: dict[str, float] = {}
        normals: list[Floats] = []
        for axis, value in ((axis, value) for axis, value in zip(axes, held, strict=True) if value is not None):
            along = int(np.abs(axis).argmax())
            if abs(axis[along]) > 1 - _PARALLEL:
                displacements["xyz"[along]] = value * float(np.sign(axis[along])) + 0.0
            elif value == 0:
                normals.append(axis)
            else:
                return None
        if len(normals) == 2:
            return _across(np.abs(np.cross(normals[0], normals[1])))
        return displacements, (normals[0] + 0.0).tolist() if normals else []


def _across(free: Floats) -> tuple[dict[str, float], list[float]] | None:
    """Return what holds all that is across a free axis of the coordinates: a region has one normal only."""
    if free.max() < 1 - _PARALLEL:
        return None
    return dict.fromkeys((name for name, part in zip("xyz", free, strict=True) if part < 0.5), 0.0), []


class Transforms:
    """Frames of the nodes of an input file.

    Args:
        nodes_of: nodes of a set by its name; ``None`` if it is unknown.
    """

    def __init__(self, file: Iterable[Keyword], nodes_of: Callable[[str], frozenset[int] | None]) -> None:
        self._nodes = nodes_of
        self._by_name: dict[str, TransformAxes] = {}
        self._by_node: dict[int, TransformAxes] = {}
        self.unknown: list[str] = []
        """sets whose nodes are not known, so that supports of other sets may be on them"""
        for keyword in file:
            if keyword.name == "TRANSFORM":
                self._read(keyword)

    def _read(self, keyword: Keyword) -> None:
        name = keyword.options.get("NSET", "")
        frame = _frame(keyword, f"*TRANSFORM of {name}")
        self._by_name[name.lower()] = frame
        nodes = self._nodes(name)
        if nodes is None:
            self.unknown.append(name)
        else:
            self._by_node.update(dict.fromkeys(nodes, frame))

    def frames(self, name: str) -> set[TransformAxes | None]:
        """Return the frames of the nodes of a set; ``None`` stands for the axes of the coordinates."""
        nodes = self._nodes(name)
        if nodes is None:
            return {self._by_name.get(name.lower())}
        return self.frames_of(nodes)

    def frames_of(self, nodes: Iterable[int]) -> set[TransformAxes | None]:
        """Return the frames of nodes."""
        return {self._by_node.get(node) for node in nodes} or {None}


def _frame(keyword: Keyword, place: str) -> TransformAxes:
    texts = keyword.lines[0] if keyword.lines else []
    points = np.array([number(text or "0", place) for text in [*texts, *["0"] * 6][:6]]).reshape(2, 3)
    kind = keyword.options.get("TYPE", "R").upper()
    if kind == "R":
        return _as_frame(frame_at(points[0], points[1], place), is_cylindrical=False)
    third = points[1] - points[0] if kind == "C" else np.zeros(3)
    if not third.any():
        raise CardError(f"{place}: TYPE={kind} with {', '.join(texts)} is not R or C with an axis")
    first = np.cross(third, np.eye(3)[np.abs(third).argmin()])
    return _as_frame(frame_at(first, np.cross(third, first), place), is_cylindrical=True)


def _as_frame(axes: Floats, *, is_cylindrical: bool) -> TransformAxes:
    return TransformAxes(tuple(tuple(axis) for axis in (axes + 0.0).tolist()), is_cylindrical)
