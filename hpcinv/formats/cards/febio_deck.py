"""Materials of parts, supports and loads of model files of FEBio (formats 2.5 to 4.0)."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import ClassVar

from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.feb_files import windings
from hpcinv.formats.cards.card import CardError, UnknownLaw, number
from hpcinv.formats.cards.deck import Deck, Measure, NodalForces
from hpcinv.formats.cards.entry import vector
from hpcinv.formats.cards.febio import root_of
from hpcinv.formats.cards.febio_curves import LoadCurves
from hpcinv.formats.cards.febio_rigid import Planes, RigidRegions
from hpcinv.job.body_kinds import SOLID

_READ = ("Module", "Control", "Globals", "Material", "Mesh", "Geometry", "MeshDomains", "Boundary", "Loads", "LoadData")
_WITHOUT_EFFECT = (
    "Output",
    "Import",
    "Step",
    "MeshData",
    "Rigid",
    "Constraints",
)  # the last step is read; data, where they are used
_AS_NODES = re.compile(r"^@(\w+):")  # a surface or an element set as a node set
_KINDS = {"surface": "surface", "elem_set": "part", "part": "part"}  # of regions, by these prefixes
_OPTIONS = frozenset(
    {"x_dof", "y_dof", "z_dof", "dofs", "dof", "value", "scale", "relative", "pressure", "traction", "force"}
    | {"x", "y", "z", "linear", "shell_bottom", "symmetric_stiffness"}
)
"""elements within conditions and loads that are read, or that do not change the load"""
_ATTRIBUTES = frozenset({"name", "type", "node_set", "surface", "elem_set", "bc", "lc", "id"})
_SHELLS = ("tri", "quad", "q4")  # beginnings of types of elements
_SIDES = {"shell_bottom": " below a shell"}  # options of loads that are not read, and what they say
_CONSTRAINT = "linear constraint"
_SLIDES = ("symmetry plane", "fixed normal displacement")
_AT_REST = ("", "STATIC", "STEADY-STATE")


def body_kind(text: str) -> str:
    """Return the name of the kind of the body: shells alone are not read."""
    return SOLID.name


def read_deck(text: str, nodes_of_sets: Mapping[str, frozenset[int]]) -> Deck:
    """Return what the model says at the end of its last step, with the values of the load curves there.

    Raises:
        CardError: it is not XML, or a number is damaged.
    """
    return _DeckReader(root_of(text), nodes_of_sets).deck()


class _DeckReader:
    def __init__(self, root: ET.Element, nodes_of_sets: Mapping[str, frozenset[int]]) -> None:
        self._sets = nodes_of_sets
        self._root, self._deck, self._curves = root, Deck(), LoadCurves(root)
        self._windings = _windings(root)
        steps = root.findall("Step/step") or root.findall("Step")  # several in format 2.5
        self._last = steps[-1:]
        if len(steps) > 1:
            self._deck.unused.append(f"steps before the last one of {len(steps)}")

    def deck(self) -> Deck:
        self._read_materials()
        conditions, bodies = self._entries("Boundary"), self._entries("Rigid")
        rigid = RigidRegions(self._root, conditions, bodies, self._factor)
        self._deck.remotes += rigid.regions
        held: dict[tuple[str, str], dict[str, float]] = {}
        for condition in conditions:
            if condition not in rigid.taken and condition.get("type") != _CONSTRAINT:
                self._read_condition(condition, held)
        for (name, of), values in held.items():
            self._deck.support(name, values, of=of)
        self._read_planes([entry for entry in conditions if entry.get("type") == _CONSTRAINT], held)
        others = [entry for entry in self._entries("Constraints") if not self._read_slide(entry)]
        others += [entry for entry in bodies if entry not in rigid.taken]
        self._deck.unused += [f"<{entry.tag} type='{entry.get('type', '')}'>" for entry in others]
        for load in self._entries("Loads"):
            self._read_load(load)
        for entry in (*conditions, *self._entries("Loads")):
            if entry.get("type") not in (_CONSTRAINT, "rigid"):
                self._list_options(entry)
        self._list_the_rest()
        return self._deck

    def _read_slide(self, entry: ET.Element) -> bool:
        """Add a surface that slides along itself; return False for other constraints."""
        if entry.get("type") not in _SLIDES or not entry.get("surface") or _is_set(entry, "shell_bottom"):
            return False
        self._deck.supports.append({"region": entry.get("surface"), "fix": ["normal"], "of": "surface"})
        return True

    def _read_planes(self, constraints: list[ET.Element], held: Mapping[tuple[str, str], Mapping[str, float]]) -> None:
        """Add supports of node sets that slide in planes; list other constraints."""
        fixed = [
            ("xyz".index(axis), self._sets.get(name, frozenset()))
            for (name, _), values in held.items()
            for axis, value in values.items()
            if not value
        ]
        planes = Planes(constraints, fixed, self._sets)
        self._deck.supports += planes.supports
        if left := len(constraints) - len(planes.taken):
            self._deck.unused.append(f"<bc type='{_CONSTRAINT}'> ({left:,})")

    def _entries(self, section: str) -> list[ET.Element]:
        """Return the entries of a section, and of the last step."""
        return [entry for place in (self._root, *self._last) for entry in place.findall(f"{section}/*")]

    def _read_materials(self) -> None:
        deck, materials = self._deck, list(self._root.iter("material"))
        names = {entry.get("id", ""): entry.get("name", entry.get("id", "")) for entry in materials}
        for domain in self._root.findall("MeshDomains/*"):
            if domain.tag == "SolidDomain":
                deck.materials[domain.get("name", "")] = names.get(domain.get("mat", ""), domain.get("mat", ""))
            else:
                deck.unused.append(f"<{domain.tag} name='{domain.get('name', '')}'>")
        self._refuse_shells({entry.get(key, ""): entry.get("type") for entry in materials for key in ("id", "name")})
        for part in self._root.iter("Elements"):
            if part.get("mat") and part.get("name"):
                deck.materials[part.get("name", "")] = names.get(part.get("mat", ""), part.get("mat", ""))

    def _refuse_shells(self, types: Mapping[str, str | None]) -> None:
        """Raise ``UnknownLaw`` for shells that are not rigid, next to solids.

        Args:
            types: of materials by name and number.
        """
        domains = {domain.get("name"): domain.get("mat") for domain in self._root.findall("MeshDomains/*")}
        elements = self._root.iter("Elements")
        for part in (part for part in elements if part.get("type", "").lower().startswith(_SHELLS)):
            material = part.get("mat") or domains.get(part.get("name")) or ""
            if types.get(material, "rigid body") != "rigid body":
                text = f"has shells, such as <Elements name='{part.get('name', '')}'>, which have no counterpart"
                raise UnknownLaw(f"{text} next to solids; delete those that bear no load, or mesh all as a solid")

    def _list_the_rest(self) -> None:
        unused = self._deck.unused
        for place in (self._root, *self._last):
            unused += [f"<{part.tag}>" for part in place if part.tag not in (*_READ, *_WITHOUT_EFFECT) and len(part)]
            for analysis in place.findall("Control/analysis"):
                kind = (analysis.text or analysis.get("type") or "").strip()
                if kind.upper() not in _AT_REST:
                    unused.append(f"inertia (analysis {kind})")

    def _list_options(self, entry: ET.Element) -> None:
        """List what a condition or a load says and this reader does not know."""
        place = entry.get("type", entry.tag)
        for option in entry:
            if option.tag not in _OPTIONS and (option.text or "").strip() not in ("0", "false"):
                self._deck.unused.append(f"<{option.tag}> of <{entry.tag} type='{place}'>")
        attributes = [name for name in entry.attrib if name not in _ATTRIBUTES]
        self._deck.unused += [f"{name}= of <{entry.tag} type='{place}'>" for name in attributes]

    def _read_condition(self, condition: ET.Element, held: dict[tuple[str, str], dict[str, float]]) -> None:
        region, of = _region_of(condition)
        kind = condition.get("type", condition.tag)
        values = self._displacements(condition, kind, region)
        if values and region:
            held.setdefault((region, of), {}).update(values)
        else:
            self._deck.unused.append(f"<{condition.tag} type='{kind}'>{f' on {region}' if region else ''}")

    def _displacements(self, condition: ET.Element, kind: str, region: str) -> dict[str, float]:
        """Return what a condition prescribes by axis; empty if it is not read."""
        if kind == "zero displacement":
            return {axis: 0.0 for axis in "xyz" if (condition.findtext(f"{axis}_dof") or "0").strip() == "1"}
        if kind == "fix":
            axes = condition.findtext("dofs") or condition.get("bc") or ""
            return {axis.strip(): 0.0 for axis in axes.split(",") if axis.strip() in tuple("xyz")}
        if kind not in ("prescribed displacement", "prescribe") or _is_set(condition, "relative"):
            return {}
        axis, amount = _axis_of(condition), _first(condition, "value", "scale")
        if axis not in tuple("xyz") or amount is None or amount.get("type", "const") != "const":
            return {}
        return {axis: number(amount.text or "", "displacement") * self._factor(amount, kind, region)}

    def _read_load(self, load: ET.Element) -> None:
        sides = [words for option, words in _SIDES.items() if _is_set(load, option)]
        kind, region = "".join([load.get("type", ""), *sides]), load.get("surface", "")
        reader = self._LOADS.get(kind) or self._LOADS.get(f"<{load.tag}>")
        if reader is None or not reader(self, load, region):
            place = region or load.get("node_set") or load.get("elem_set") or ""
            self._deck.unused.append(f"<{load.tag}> type='{kind}'{f' on {place}' if place else ''}")

    def _add_pressure(self, load: ET.Element, region: str) -> bool:
        """Add a pressure; return False if it varies in space, or facets of its surface turn both ways."""
        value, turn = self._pressure(load, region), self._windings.get(region, 1)
        if value is None or not turn:
            return False
        value = replace(value, value=turn * value.value)
        key = "dead_pressure" if _is_set(load, "linear") else "pressure"
        self._deck.effects.append({"effect": "pressure", "region": region, key: value})
        return True

    def _add_traction(self, load: ET.Element, region: str) -> bool:
        if not region:
            return False
        area_in = "reference" if _is_set(load, "linear") else "current"
        effect = {"effect": "traction", "region": region, "traction": self._traction(load, region)}
        self._deck.effects.append(effect | {"area_in": area_in})
        return True

    def _add_nodal_load(self, load: ET.Element, region: str) -> bool:
        if (nodal := self._nodal_force(load)) is None:
            return False
        name, of = _region_of(load)
        forces = dict.fromkeys(self._sets.get(name, frozenset()), nodal)
        self._deck.forces.append(NodalForces(name, f"<nodal_load> on {name}", forces, of))
        return True

    def _add_body_load(self, load: ET.Element, region: str) -> bool:
        if load.get("elem_set") or (force := self._body_force(load)) is None:
            return False
        self._add_weight(force)
        return True

    _LOADS: ClassVar[Mapping[str, Callable[[_DeckReader, ET.Element, str], bool]]] = {
        "pressure": _add_pressure,
        "traction": _add_traction,
        "<nodal_load>": _add_nodal_load,
        "<body_load>": _add_body_load,
    }
    """by type or name of the element"""

    def _pressure(self, load: ET.Element, region: str) -> Measure | None:
        """Return a pressure; ``None`` if it varies in space."""
        size = _first(load, "pressure", "value")
        if size is None or size.get("type", "const") != "const":
            return None
        factor = self._factor(size, "pressure", region)
        return Measure(number(size.text or "", "pressure") * factor, stress=1)

    def _traction(self, load: ET.Element, region: str) -> list[Measure]:
        scale, direction = load.find("scale"), load.find("traction")
        factors = [self._factor(item, "traction", region) for item in (scale, direction) if item is not None]
        factor = math.prod([*factors, 1.0 if scale is None else number(scale.text or "1", "scale")])
        return [Measure(factor * entry, stress=1) for entry in vector(load.findtext("traction"), "traction")]

    def _nodal_force(self, load: ET.Element) -> tuple[float, float, float] | None:
        """Return the force at each node of a load; ``None`` if it is something else."""
        axis, size = _axis_of(load), _first(load, "scale", "value")
        if size is None:
            return None
        factor, name = self._factor(size, "nodal_load", load.get("node_set", "")), load.get("node_set", "")
        if axis in tuple("xyz"):
            x, y, z = (factor * number(size.text or "1", "nodal_load") * (axis == other) for other in "xyz")
        elif load.get("type") == "nodal_force" and name:
            x, y, z = (factor * entry for entry in vector(size.text, "nodal_load"))
        else:
            return None
        return x, y, z

    def _body_force(self, load: ET.Element) -> tuple[float, ...] | None:
        """Return the acceleration of a body force, whose sign is the opposite in these files."""
        kind, force = load.get("type", ""), load.find("force")
        if kind == "body force" and force is not None and force.get("type", "const") == "const":
            factor = self._factor(force, kind, "the body")
            return tuple(0.0 - factor * entry for entry in vector(force.text, "force"))
        if kind == "const":
            items = [load.find(axis) for axis in "xyz"]
            return tuple(
                0.0
                if item is None
                else 0.0 - self._factor(item, kind, "the body") * number(item.text or "1", "body_load")
                for item in items
            )
        return None

    def _add_weight(self, acceleration: tuple[float, ...]) -> None:
        densities = {
            material.get("name", material.get("id", "")): number(material.findtext("density", "1"), "density")
            for material in self._root.findall("Material/material")
            if self._root.find("Material/material/density") is not None  # where one has a density, others have 1
        }
        components = [Measure(component, length=1, time=-2) for component in acceleration]
        effect = {"effect": "gravity", "acceleration": components}
        self._deck.mass_load(effect, densities, "<body_load>", "<density>")

    def _factor(self, item: ET.Element, what: str, region: str) -> float:
        """Return the value of the load curve of an entry at the end; 1 without one."""
        label = item.get("lc")
        if not label:
            return 1.0
        try:
            return self._curves.at_end(label)
        except CardError as error:
            self._deck.unused.append(f"load curve {label} of the {what} on {region}: {error}")
            return 1.0


def _windings(root: ET.Element) -> Mapping[str, int]:
    try:
        return windings(root)
    except (Fault, KeyError):  # the reader of the mesh reports it
        return {}


def _region_of(entry: ET.Element) -> tuple[str, str]:
    """Return the name of the nodes of a condition, and what has that name."""
    name = entry.get("node_set") or entry.get("surface") or ""
    prefix = _AS_NODES.match(name)
    of = _KINDS.get(prefix[1], "nodes") if prefix else "nodes" if entry.get("node_set") else "surface"
    return _AS_NODES.sub("", name), of


def _axis_of(entry: ET.Element) -> str:
    return (entry.findtext("dof") or entry.get("bc") or "").strip()


def _first(entry: ET.Element, *tags: str) -> ET.Element | None:
    """Return the element within an entry of the first tag that it has."""
    return next((item for tag in tags if (item := entry.find(tag)) is not None), None)


def _is_set(entry: ET.Element, flag: str) -> bool:
    return (entry.findtext(flag) or "0").strip() not in ("0", "false")
