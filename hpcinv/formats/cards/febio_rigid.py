"""Rigid regions with their loads, and planes in which nodes stay, in models of FEBio (format 4.0)."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hpcinv.base.quantity.arrays import Floats
from hpcinv.formats.cards.card import CardError, number
from hpcinv.formats.cards.deck import Measure, RigidRegion
from hpcinv.formats.cards.entry import vector

_COMPONENTS = {"rigid_force": ("Rx", "Ry", "Rz"), "rigid_moment": ("Ru", "Rv", "Rw")}
_AXES = {"x": 0, "y": 1, "z": 2}
_FLAT = 1e-6
"""Difference of unit normals of one plane; raised, shallow curved faces are taken for planes."""
_MOST_PLANES = 20
"""More normals are of a curved face. Raised, files of such faces take longer."""


class RigidRegions:
    """Node sets of rigid bodies that only forces and moments move.

    Args:
        conditions: entries of the section of the boundary.
        rigid: entries of the section of rigid bodies.
        factor: returns the value of the load curve of an entry at the end.
    """

    def __init__(
        self,
        root: ET.Element,
        conditions: Sequence[ET.Element],
        rigid: Sequence[ET.Element],
        factor: Callable[[ET.Element, str, str], float],
    ) -> None:
        self._factor = factor
        materials = [entry for entry in root.iter("material") if entry.get("type") == "rigid body"]
        has_elements = {entry.get("mat") for entry in (*root.findall("MeshDomains/*"), *root.iter("Elements"))}
        self.regions: list[RigidRegion] = []
        self.taken: list[ET.Element] = []
        """entries of the file that the regions say"""
        for material in materials:
            sets = [entry for entry in conditions if entry.get("type") == "rigid" and self._is_of(entry, material)]
            own = [entry for entry in rigid if self._is_of(entry, material)]
            place = material.findtext("center_of_mass")
            names = {material.get("name"), material.get("id")}
            if len(sets) != 1 or place is None or names & has_elements or not all(map(_is_load, own)):
                continue
            about = [Measure(part, length=1) for part in vector(place, "center_of_mass")]
            region = sets[0].get("node_set", "")
            remote = {"force": self._total("rigid_force", own, region, 2), "about": about}
            remote["moment"] = self._total("rigid_moment", own, region, 3)
            self.regions.append(RigidRegion(region, "nodes", {"remote": remote}))
            self.taken += [sets[0], *own]

    @staticmethod
    def _is_of(entry: ET.Element, material: ET.Element) -> bool:
        return (entry.findtext("rb") or "").strip() in (material.get("id"), material.get("name"))

    def _total(self, kind: str, loads: Sequence[ET.Element], region: str, length: int) -> list[Measure]:
        """Return the components of the forces, or of the moments."""
        total = [0.0, 0.0, 0.0]
        for load in loads:
            if load.get("type") == kind and (value := load.find("value")) is not None:
                size = number(value.text or "", kind) * self._factor(value, kind, region)
                total[_place_of(load, kind)] += size
        return [Measure(part, length=length, stress=1) for part in total]


def _is_load(entry: ET.Element) -> bool:
    """Return whether an entry is a force or a moment that keeps its direction."""
    kind = (entry.findtext("load_type") or "LOAD").strip()
    relative = (entry.findtext("relative") or "0").strip()
    return entry.get("type") in _COMPONENTS and kind in ("LOAD", "0") and relative in ("0", "false")


def _place_of(load: ET.Element, kind: str) -> int:
    text = (load.findtext("dof") or "0").strip()
    places = {name: place for place, name in enumerate(_COMPONENTS[kind])} | {str(i): i for i in range(3)}
    if text not in places:
        raise CardError(f"{kind}: dof {text!r} is not {', '.join(_COMPONENTS[kind])}")
    return places[text]


class Planes:
    """Node sets whose nodes stay in planes, by linear constraints of one node each.

    Args:
        held: sets of nodes that do not move along an axis (0, 1, 2).
    """

    def __init__(
        self,
        constraints: Sequence[ET.Element],
        held: Sequence[tuple[int, frozenset[int]]],
        sets: Mapping[str, frozenset[int]],
    ) -> None:
        own = [(*found, entry) for entry in constraints if (found := _direction_of(entry)) is not None]
        known, covered = defaultdict[int, list[Floats]](list), defaultdict[int, list[Floats]](list)
        for axis, nodes in held:
            for node in nodes:
                known[node].append(np.eye(3)[axis])
                covered[node].append(np.eye(3)[axis])
        for node, direction, _ in own:
            known[node].append(direction)
        self.supports: list[dict[str, Any]] = []
        for normal in _normals([direction for _, direction, _ in own]):
            along = frozenset(node for node, direction, _ in own if np.abs(direction - normal).max() < _FLAT)
            name = _smallest(sets, along, known, normal)
            if name is not None:
                self.supports.append({"region": name, "fix": ["normal"], "normal": normal.tolist()})
                for node in sets[name]:
                    covered[node].append(normal)
        self.taken = [entry for node, direction, entry in own if _spans(covered[node], direction)]
        """entries of the file that the supports say"""


def _smallest(
    sets: Mapping[str, frozenset[int]], part: frozenset[int], known: Mapping[int, Sequence[Floats]], normal: Floats
) -> str | None:
    """Return the smallest set that contains a part and does not move along a normal, by what is known of its nodes."""
    wider = (name for name, nodes in sets.items() if nodes and part <= nodes)
    ordered = sorted(wider, key=lambda name: len(sets[name]))
    return next((name for name in ordered if all(_spans(known[node], normal) for node in sets[name])), None)


def _direction_of(entry: ET.Element) -> tuple[int, Floats] | None:
    """Return node and unit direction of a constraint of one node without a constant; ``None`` for others."""
    (node, axis, _), *others = map(_term, (entry, *entry.iter("child_dof")))
    is_of_one = node.isdecimal() and {own for own, _, _ in others} <= {node}
    if not is_of_one or not {axis, *(dof for _, dof, _ in others)} <= _AXES.keys():
        return None
    if number(entry.findtext("offset", "0"), "offset"):
        return None
    direction = np.eye(3)[_AXES[axis]]
    for _, dof, value in others:
        direction[_AXES[dof]] -= number(value or "1", "linear constraint")
    if not (size := float(np.linalg.norm(direction))):
        return None
    return int(node), direction / size * np.sign(direction[np.abs(direction).argmax()])


def _term(entry: ET.Element) -> tuple[str, str, str]:
    """Return node, axis and factor of a term of a linear constraint; the constraint itself is the first one."""
    node, axis, factor = ((entry.findtext(tag) or "").strip() for tag in ("node", "dof", "value"))
    return node, axis, factor


def _normals(directions: Sequence[Floats]) -> Iterator[Floats]:
    """Yield different directions, the most frequent first; nothing for the normals of curved faces."""
    found: list[tuple[Floats, int]] = []
    for direction in directions:
        same = next((i for i, (other, _) in enumerate(found) if np.abs(direction - other).max() < _FLAT), None)
        if same is None:
            found.append((direction, 1))
        else:
            found[same] = found[same][0], found[same][1] + 1
        if len(found) > _MOST_PLANES:
            return
    yield from (direction for direction, _ in sorted(found, key=lambda item: -item[1]))


def _spans(directions: Sequence[Floats], normal: Floats) -> bool:
    """Return whether a direction is a sum of multiples of others."""
    if not len(directions):
        return False
    matrix = np.array(directions).T
    parts = np.linalg.lstsq(matrix, normal, rcond=None)[0]
    return bool(np.abs(matrix @ parts - normal).max() < _FLAT)
