"""Files of FEBio (``.feb``, formats 2.5, 3.0, 4.0): nodes, solid elements, sets, boundary conditions, loads, materials.

The model is taken at the end of its last step: each value is multiplied by its load curve there. What the reader does
not know (contact, rigid bodies, constraints, …) is listed in `Model.unread`, so that a caller can refuse the file.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hpcinv.formats.cards.card import CardError
from hpcinv.formats.cards.entry import Entry, entry_of
from hpcinv.formats.cards.febio_curves import LoadCurves

from .older_formats import FORMATS, in_format_4

type Ints = npt.NDArray[np.int64]
type Floats = npt.NDArray[np.float64]

LARGEST = 200e6
"""Largest file (bytes) that is read; raised, a damaged or hostile file can fill more memory."""

NODES_OF = {"tet4": 4, "tet10": 10, "hex8": 8, "hex20": 20, "hex27": 27, "penta6": 6, "penta15": 15}
AXES = ("x", "y", "z")


class FebError(Exception):
    """A file that cannot be read; the message names file and place."""


@dataclass(frozen=True)
class BoundaryCondition(Entry):
    """A load or a boundary condition, with the name of the set or surface on which it acts."""

    region: str = ""


@dataclass(frozen=True)
class ElementBlock:
    """Elements of one kind: their node numbers (m, k) in the order of the file, and the name of their material."""

    name: str
    kind: str
    numbers: Ints
    nodes: Ints
    material: str
    formulation: str


@dataclass(frozen=True)
class Model:
    """Content of a file; nodes are named by their numbers in it.

    Attributes:
        node_sets: node numbers by name of the set.
        surfaces: facets (node numbers of each) by name of the surface.
        element_data: arrays (elements, components) by name, with the name of their block.
        mat_axes: axes (elements, 2, 3) a and d of the blocks that have them.
        conditions: prescribed displacements, zero or not.
        unread: elements of the file that the reader does not know.
        rest: time before the end in which no load changes.
    """

    path: Path
    version: str
    numbers: Ints
    points: Floats
    blocks: tuple[ElementBlock, ...]
    node_sets: Mapping[str, Ints]
    surfaces: Mapping[str, tuple[Ints, ...]]
    element_data: Mapping[str, tuple[str, Floats]]
    mat_axes: Mapping[str, Floats]
    materials: Mapping[str, Entry]
    conditions: tuple[BoundaryCondition, ...]
    loads: tuple[BoundaryCondition, ...]
    unread: tuple[str, ...]
    rest: float

    def nodes_of(self, region: str) -> Ints:
        """Return the node numbers of a set, a surface (``@surface:NAME``) or a block (``@elem_set:NAME``)."""
        kind, _, name = region.rpartition(":")
        try:
            if kind == "@surface":
                return np.unique(np.concatenate(self.surfaces[name]))
            if kind == "@elem_set":
                return np.unique(np.concatenate([block.nodes.ravel() for block in self.blocks if block.name == name]))
            return self.node_sets[region]
        except (KeyError, ValueError):
            raise FebError(f"{self.path}: there is no set '{region}'") from None


def read_feb(path: Path) -> Model:
    """Read a file.

    Raises:
        FebError: the file is missing, damaged or of another format.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise FebError(f"{path}: has more than {LARGEST / 1e6:.0f} MB")
        data = path.read_bytes()
        if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
            raise FebError(f"{path}: has definitions of entities, which could fill the memory")
        root = ET.fromstring(data)
    except OSError as error:
        raise FebError(f"{path}: {error.strerror}") from error
    except (ET.ParseError, LookupError) as error:  # an unknown encoding
        raise FebError(f"{path}: is not XML: {error}") from error
    version = root.get("version", "")
    if root.tag != "febio_spec" or version not in FORMATS:
        what = f"is of format {version}" if root.tag == "febio_spec" else "is not a model of FEBio"
        raise FebError(f"{path}: {what}; formats {', '.join(FORMATS)} can be read: save it again with FEBio Studio")
    try:
        in_format_4(root)
        return _FebReader(path, root).model()
    except FebError as error:
        raise FebError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
    except ValueError as error:
        raise FebError(f"{path}: a value cannot be read: {error}") from None


@dataclass
class _FebReader:
    path: Path
    root: ET.Element
    unread: list[str] = field(default_factory=list)
    last_change: float = 0.0

    def __post_init__(self) -> None:
        self._curves = LoadCurves(self.root)

    def model(self) -> Model:
        mesh = self._section("Mesh")
        numbers, points = _nodes(mesh)
        data, axes = self._mesh_data(mesh)
        known = {"Module", "Control", "Globals", "Material", "Mesh", "MeshDomains", "MeshData", "Boundary", "Loads"}
        known |= {"LoadData", "Output"}
        self.unread += [child.tag for child in self.root if child.tag not in known and len(child)]
        module = self._section("Module").get("type", "")
        analysis = self.root.findtext("Control/analysis", "STATIC").strip().upper()
        self.unread += [f"module {module}"] * (module != "solid") + [f"analysis {analysis}"] * (analysis != "STATIC")
        materials = {_name(item): entry_of(item, self._curve) for item in self._section("Material")}
        conditions = tuple(self._condition(item, item.get("node_set", "")) for item in self._list("Boundary"))
        loads = tuple(
            self._condition(item, item.get("surface") or item.get("node_set") or "") for item in self._list("Loads")
        )
        blocks = tuple(self._blocks(mesh))
        for block in blocks:
            if lost := sorted(set(block.nodes.ravel().tolist()) - set(numbers.tolist())):
                raise FebError(f"elements '{block.name}': there is no node {lost[0]}")
        return Model(
            path=self.path,
            version=self.root.get("version", ""),
            numbers=numbers,
            points=points,
            blocks=blocks,
            node_sets={_name(item): _integers(item.text, _name(item)) for item in mesh.iter("NodeSet")},
            surfaces={
                _name(item): tuple(_integers(facet.text, _name(item)) for facet in item)
                for item in mesh.iter("Surface")
            },
            element_data=data,
            mat_axes=axes,
            materials=materials,
            conditions=conditions,
            loads=loads,
            unread=tuple(self.unread),
            rest=self._curves.end - self.last_change,
        )

    def _section(self, tag: str) -> ET.Element:
        if (section := self.root.find(tag)) is None:
            raise FebError(f"there is no section <{tag}>")
        return section

    def _list(self, tag: str) -> Sequence[ET.Element]:
        section = self.root.find(tag)
        return [] if section is None else list(section)

    def _condition(self, item: ET.Element, region: str) -> BoundaryCondition:
        return BoundaryCondition(**vars(entry_of(item, self._curve)), region=region)

    def _curve(self, number: str) -> float:
        """Value of a load curve at the end."""
        try:
            value = self._curves.at_end(number)
            if any(self._curves.points(number)[:, 1] != value):
                self.last_change = self._curves.end  # it may have changed until the end
        except CardError as error:
            raise FebError(str(error)) from None
        return value

    def _blocks(self, mesh: ET.Element) -> Iterator[ElementBlock]:
        domains = {item.get("name"): item for item in self._list("MeshDomains")}
        for item in mesh.iter("Elements"):
            kind = item.get("type", "").lower()
            if kind not in NODES_OF:
                self.unread.append(f"elements {kind}")
                continue
            rows = [_integers(element.text, _name(item)) for element in item]
            if not rows or any(len(row) != NODES_OF[kind] for row in rows):
                raise FebError(f"elements '{_name(item)}': a {kind} has {NODES_OF[kind]} nodes")
            domain = domains.get(_name(item))
            material, formulation = ("", "") if domain is None else (domain.get("mat", ""), domain.get("type", ""))
            numbers = np.array([int(element.get("id", "0")) for element in item], dtype=np.int64)
            yield ElementBlock(_name(item), kind, numbers, np.array(rows, dtype=np.int64), material, formulation)

    def _mesh_data(self, mesh: ET.Element) -> tuple[dict[str, tuple[str, Floats]], dict[str, Floats]]:
        data: dict[str, tuple[str, Floats]] = {}
        axes: dict[str, Floats] = {}
        for item in self._list("MeshData"):
            block = item.get("elem_set", "")
            if item.tag != "ElementData":
                self.unread.append(item.tag)
            elif item.get("type") == "mat_axis":
                rows = [[_numbers(element.findtext(axis), "mat_axis") for axis in ("a", "d")] for element in item]
                axes[block] = np.array(rows)
            elif item.get("name"):
                data[_name(item)] = block, np.array([_numbers(element.text, _name(item)) for element in item])
            else:
                self.unread.append(f"ElementData {item.get('type')}")
        return data, axes


def _nodes(mesh: ET.Element) -> tuple[Ints, Floats]:
    items = [node for group in mesh.iter("Nodes") for node in group]
    numbers = np.array([int(node.get("id", "0")) for node in items], dtype=np.int64)
    if len(np.unique(numbers)) < len(numbers):
        raise FebError("two nodes have the same number")
    points = np.array([_numbers(node.text, f"node {node.get('id')}") for node in items]).reshape(-1, 3)
    return numbers, points


def _name(item: ET.Element) -> str:
    return item.get("name", "")


def _integers(text: str | None, where: str) -> Ints:
    try:
        return np.array((text or "").replace(",", " ").split(), dtype=np.int64)
    except ValueError:
        raise FebError(f"{where}: is not a list of numbers") from None


def _numbers(text: str | None, where: str) -> Floats:
    try:
        numbers = np.array((text or "").replace(",", " ").split(), dtype=np.float64)
    except ValueError:
        raise FebError(f"{where}: is not a list of numbers") from None
    if not all(map(math.isfinite, numbers)):
        raise FebError(f"{where}: has a number that is not finite")
    return numbers
