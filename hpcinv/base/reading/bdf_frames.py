"""Coordinate systems of Nastran that grid points are in: CORD2R, CORD2C and CORD2S.

Source: *MSC Nastran Quick Reference Guide*, "Bulk Data Entries", CORD2R, CORD2C, CORD2S and GRDSET.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hpcinv.base.reading.coordinate_frames import frame_of
from hpcinv.base.reading.fault import Fault, shown
from hpcinv.base.reading.numbered_elements import number, whole_number

KINDS = ("CORD2R", "CORD2C", "CORD2S")
"""rectangular, cylindrical and spherical ones, by three points"""
BY_NODES = ("CORD1R", "CORD1C", "CORD1S", "CORD3G")
"""others, which are refused where a grid point is in one"""
_ADVICE = "Save the mesh in the basic coordinate system."


class CoordinateCard(NamedTuple):
    """A coordinate system as the file states it."""

    place: str
    kind: str
    fields: Sequence[str]


class Frames:
    """Coordinate systems by their numbers."""

    def __init__(self, entries: Mapping[int, CoordinateCard]) -> None:
        self._entries = entries
        self._known: dict[int, tuple[str, Any, Any]] = {0: ("CORD2R", np.zeros(3), np.eye(3))}

    def position(self, coordinates: Sequence[float], system: str, place: str) -> list[float]:
        """Return a position in the basic coordinate system.

        Args:
            coordinates: in a system; angles in degrees.
            system: its number; empty for the basic one.
            place: for messages.
        """
        tag = whole_number(system, place) if system.strip() else 0
        if tag == 0:
            return list(coordinates)
        kind, origin, axes = self._frame(tag, place, ())
        result: list[float] = (origin + _rectangular(kind, coordinates) @ axes).tolist()
        return result

    def _frame(self, tag: int, place: str, above: tuple[int, ...]) -> tuple[str, Any, Any]:
        """Return kind, origin and axes (rows) of a system."""
        if tag in self._known:
            return self._known[tag]
        entry = self._entries.get(tag)
        if entry is None:
            raise Fault(f"{place}: coordinate system {tag} is not defined", "Is the file complete?")
        if entry.kind not in KINDS:
            raise Fault(f"{place}: coordinate system {tag} is a {shown(entry.kind)}, which is not read", _ADVICE)
        if tag in above:
            raise Fault(f"{entry.place}: coordinate system {tag} refers to itself", _ADVICE)
        parent = whole_number(entry.fields[1], entry.place) if "".join(entry.fields[1:2]).strip() else 0
        kind, start, turned = self._frame(parent, entry.place, (*above, tag))
        texts = [*entry.fields[2:11], *[""] * 9][:9]
        points = np.array([number(text, entry.place) for text in texts]).reshape(3, 3)
        origin, on_z, in_xz = (start + _rectangular(kind, point) @ turned for point in points)
        frame = frame_of(on_z - origin, in_xz - origin)  # z, x and y
        if frame is None:
            raise Fault(f"{entry.place}: the points of coordinate system {tag} are on one line", _ADVICE)
        self._known[tag] = entry.kind, origin, frame[[1, 2, 0]]
        return self._known[tag]


def _rectangular(kind: str, coordinates: Any) -> Any:
    """Return rectangular coordinates of cylindrical (r, θ, z) and spherical ones (r, θ from the axis z, φ)."""
    first, second, third = coordinates
    if kind == "CORD2C":
        angle = np.radians(second)
        return np.array([first * np.cos(angle), first * np.sin(angle), third])
    if kind == "CORD2S":
        polar, angle = np.radians(second), np.radians(third)
        return first * np.array([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)])
    return np.array(coordinates)
