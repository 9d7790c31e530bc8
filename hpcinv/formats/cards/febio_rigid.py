"""Rigid regions with their loads, and planes in which nodes stay, in models of FEBio (format 4.0)."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hpcinv.base.quantity.arrays import Floats
from hpcinv.formats.cards.card import CardError, number
from hpcinv.formats.cards.deck import Measure, RigidRegion
from hpcinv.formats.cards.entry import vector

_COMPONENTS = {"rigid_force": ("Rx", "Ry", "Rz"), "rigid_moment": ("Ru", "Rv", "Rw")}
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
        self._materials = [entry for entry in root.iter("material") if entry.get("type") == "rigid body"]
        has_elements = {entry.get("mat") for entry in (*root.findall("MeshDomains/*"), *root.iter("Elements"))}
        named = [[e for e in conditions if e.get("type") == "rigid" and self._is_of(e, m)] for m in self._materials]
        self.regions: list[RigidRegion] = []
        self.taken: list[ET.Element] = []
        """entries of the file that the regions say"""
        for material, sets in zip(self._materials, named, strict=True):
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
        known: dict[int, list[Floats]] = {}
        covered: dict[int, list[Floats]] = {}
        for axis, nodes in held:
            for node in nodes:
                known.setdefault(node, []).append(np.eye(3)[axis])
                covered.setdefault(node, []).append(np.eye(3)[axis])
        own: list[tuple[int, Floats, ET.Element]] = []
        for entry in constraints:
            if (found := _direction_of(entry)) is not None:
                own.append((*found, entry))
                known.setdefault(found[0], []).append(found[1])
        self.supports: list[dict[str, Any]] = []
        smallest = sorted((name for name in sets if sets[name]), key=lambda name: len(sets[name]))
        for normal in _normals([direction for _, direction, _ in own]):
            nodes = frozenset(node for node, direction, _ in own if np.abs(direction - normal).max() < _FLAT)
            for name in (name for name in smallest if nodes <= sets[name]):
                if all(_spans(known.get(node, ()), normal) for node in sets[name]):
                    self.supports.append({"region": name, "fix": ["normal"], "normal": normal.tolist()})
                    for node in sets[name]:
                        covered.setdefault(node, []).append(normal)
                    break
        self.taken = [entry for node, direction, entry in own if _spans(covered.get(node, ()), direction)]
        """entries of the file that the supports say"""


def _direction_of(entry: ET.Element) -> tuple[int, Floats] | None:
    """Return node and unit direction of a constraint of one node without a constant; ``None`` for others."""
    node, direction = (entry.findtext("node") or "").strip(), np.zeros(3)
    children = [[(c.findtext(tag) or "").strip() for tag in ("node", "dof", "value")] for c in entry.iter("child_dof")]
    terms = [("1", (entry.findtext("dof") or "").strip()), *((value or "1", dof) for _, dof, value in children)]
    is_whole = (
        node.isdecimal() and all(own == node for own, _, _ in children) and all(dof in tuple("xyz") for _, dof in terms)
    )
    if not is_whole or number(entry.findtext("offset", "0"), "offset"):
        return None
    for place, (value, dof) in enumerate(terms):
        direction["xyz".index(dof)] += number(value, "linear constraint") * (1 if place == 0 else -1)
    if not (size := float(np.linalg.norm(direction))):
        return None
    return int(node), direction / size * np.sign(direction[np.abs(direction).argmax()])


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
