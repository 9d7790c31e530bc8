"""Model files of FEBio (``.feb``, formats 2.5 to 4.0): nodes, solid elements, sets and surfaces."""

import contextlib
import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.element_faces import FACES
from hpcinv.base.reading.fault import Fault, shown
from hpcinv.base.reading.feb_data import directions_in
from hpcinv.base.reading.feb_model import local_name, local_nodes, model_of
from hpcinv.base.reading.numbered_elements import integers

_SOLID = {"tet4": 4, "tet10": 10, "hex8": 8, "hex20": 20, "hex27": 27}
_KIND = re.compile(r"(tet4|tet10|hex8|hex20|hex27)(g\d+|gl11|ri)?")
"""types of elements, in lower case; the integration points at their end do not count"""
_FLAT = ("tri", "quad", "line", "truss", "q4ans", "q4eas")  # shells, surfaces and trusses, which are left out
_COMPLETE = [*range(20), 26, 24, 25, 20, 21, 22, 23]
"""places of the nodes of C3D27 in the order of hex27"""
_GENERAL = ("Module", "Globals", "Control", "Output", "MeshDomains")
_FACETS = {"tri3": 3, "tri6": 3, "quad4": 4, "quad8": 4, "quad9": 4}  # with their vertices


def read_feb(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return arrays of nodes, elements and sets as `inp_files` does; surfaces are ``facets:NAME``."""
    root, mesh = _model(path)
    nodes, sets = _nodes(mesh)
    cells, cell_tags, blocks = _elements(mesh)
    if not cells:
        raise _no_solids(mesh)
    for part in mesh.iter("NodeSet"):
        sets.setdefault(f"nodes:{_name(part)}", []).extend(_members(part))
    for part in mesh.iter("ElementSet"):
        blocks.setdefault(_name(part), []).extend(_members(part))
    row = {tag: i for i, tag in enumerate(nodes)}
    arrays: dict[str, Any] = {
        "points": np.array(list(nodes.values())),
        "node_tags": integers(list(nodes), "numbers of nodes"),
        "cells": _rows(row, cells, "an element"),
        "cell_tags": integers(cell_tags, "numbers of elements"),
    }
    arrays |= _cell_sets(blocks, cell_tags)
    arrays |= {key: np.unique(_rows(row, [tags], "a node set")) for key, tags in sets.items() if tags}
    arrays |= {key: _rows(row, facets, "a surface") for key, facets in _surfaces(mesh, cells).items() if facets}
    for nodes_of_fibre in _local_fibres(root):
        first, second = (arrays["points"][_local(arrays["cells"], number)] for number in nodes_of_fibre)
        arrays[f"values:{local_name(nodes_of_fibre)}"] = second - first
    arrays |= {f"values:{name}": values for name, values in directions_in(root, blocks, cell_tags).items()}
    ignored = [part.tag for part in root if part is not mesh and part.tag not in _GENERAL and len(part)]
    return {"ignored": ignored}, arrays


def _no_solids(mesh: ET.Element) -> Fault:
    types = [part.get("type", "").lower() for part in mesh.iter("Elements")]
    remedy = " Save shells as .vtu or .inp, with 'mesh: {shell: …}'." if any(t.startswith(_FLAT) for t in types) else ""
    return Fault("has no solid elements", f"Elements are {', '.join(_SOLID)}.{remedy}")


def _cell_sets(blocks: dict[str, list[int]], cell_tags: list[int]) -> dict[str, Any]:
    """Return the rows of the solid elements of each set that has some; other elements are shells."""
    row = {tag: i for i, tag in enumerate(cell_tags)}
    members = {name: [row[tag] for tag in tags if tag in row] for name, tags in blocks.items()}
    return {f"cells:{name}": np.unique(rows) for name, rows in members.items() if rows}


def _model(path: Path) -> tuple[ET.Element, ET.Element]:
    """Return the elements of the model and of its mesh."""
    root = model_of(admitted(path).read_bytes())
    mesh = root.find("Mesh") if root.find("Mesh") is not None else root.find("Geometry")
    if root.tag != "febio_spec" or mesh is None:
        raise Fault("is not a model of FEBio with a mesh", "Save the model with FEBio Studio.")
    return root, mesh


def _nodes(mesh: ET.Element) -> tuple[dict[int, list[float]], dict[str, list[int]]]:
    """Return places by the numbers of nodes, and these numbers by ``nodes:`` and the name of their section."""
    nodes: dict[int, list[float]] = {}
    sets: dict[str, list[int]] = {}
    for part in mesh.iter("Nodes"):
        tags = [_tag(node) for node in part.iter("node")]
        if twice := next((tag for tag in tags if tag in nodes), None):
            raise Fault(f"node {twice} is defined twice", "Number the nodes again.")
        nodes |= {tag: _position(node) for tag, node in zip(tags, part.iter("node"), strict=True)}
        if name := part.get("name"):
            sets.setdefault(f"nodes:{name}", []).extend(tags)
    return nodes, sets


def _surfaces(mesh: ET.Element, cells: list[list[int]]) -> dict[str, list[list[int]]]:
    """Return the vertices of the facets of each surface by ``facets:`` and its name, without facets of shells alone."""
    shells, corners = _shells(mesh, cells), 3 if len(cells[0]) in (4, 10) else 4
    surfaces: dict[str, list[list[int]]] = {}
    for part in mesh.iter("Surface"):
        name = _name(part)
        if unknown := next((facet.tag for facet in part if facet.tag not in _FACETS), None):
            text = f"surface '{shown(name)}' has facets '{shown(unknown)}'"
            raise Fault(text, f"Facets are {', '.join(_FACETS)}.")
        facets = [_integers(facet)[: _FACETS[facet.tag]] for facet in part]
        solid = [facet for facet in facets if frozenset(facet) not in shells]
        if any(len(facet) != corners for facet in solid):
            text = f"surface '{shown(name)}' has facets that no solid element has"
            raise Fault(text, "Save the surface of the solids.")
        surfaces.setdefault(f"facets:{name}", []).extend(solid)
    return surfaces


def windings(root: ET.Element) -> dict[str, int]:
    """Return by the name of a surface: 1 if its facets turn about outward normals, -1 if inward, 0 if both occur.

    FEBio presses along the negative normal of a facet, as its nodes turn.
    """
    mesh = root.find("Mesh") if root.find("Mesh") is not None else root.find("Geometry")
    if mesh is None:
        return {}
    places, cells = _nodes(mesh)[0], _elements(mesh)[0]
    surfaces = {key[7:]: facets for key, facets in _surfaces(mesh, cells).items()} if cells else {}
    wanted = {frozenset(facet) for facets in surfaces.values() for facet in facets}
    middles = dict[frozenset[int], Any]()
    for cell in cells:
        vertices = cell[: 4 if len(cell) in (4, 10) else 8]
        for face in FACES[len(vertices)]:
            if (key := frozenset(vertices[i] for i in face)) in wanted:
                middles[key] = np.mean([places[tag] for tag in vertices], axis=0)
    return {name: _winding(facets, places, middles) for name, facets in surfaces.items()}


def _winding(facets: list[list[int]], places: dict[int, list[float]], middles: dict[frozenset[int], Any]) -> int:
    turns = set[int]()
    for facet in facets:
        if (middle := middles.get(frozenset(facet))) is not None:
            corners = np.array([places[tag] for tag in facet])
            normal = np.cross(corners[-2] - corners[0], corners[-1] - corners[len(corners) - 3])
            turns.add(1 if normal @ (corners.mean(axis=0) - middle) > 0 else -1)
    return turns.pop() if len(turns) == 1 else 0


def _rows(row: dict[int, int], tags: list[list[int]], owner: str) -> Any:
    """Return the rows of nodes by their numbers."""
    return np.array([[_row(row, tag, owner) for tag in own] for own in tags], dtype=np.int64)


def _local_fibres(root: ET.Element) -> Iterator[tuple[int, int]]:
    """Yield the nodes of an element between which fibres of a material point; damaged ones are reported with it."""
    for fibre in root.iter("fiber"):
        if fibre.get("type") == "local":
            with contextlib.suppress(ValueError):
                yield local_nodes((fibre.findtext("local") or fibre.text or "").strip() or "0,0")


def _local(cells: Any, number: int) -> Any:
    """Return a node of each cell."""
    if number > cells.shape[1]:
        raise Fault(f"has fibres to node {number} of elements of {cells.shape[1]} nodes", "Correct <fiber>.")
    return cells[:, number - 1]


def _shells(mesh: ET.Element, cells: list[list[int]]) -> set[frozenset[int]]:
    """Return the vertices of the shells that are on no solid element; surfaces on them are left out."""
    flat = {
        frozenset(_integers(element)[: 3 if kind.startswith("tri") else 4])
        for part in mesh.iter("Elements")
        if (kind := part.get("type", "").lower()).startswith(("tri", "quad", "q4"))
        for element in part
    }
    if flat:
        faces = FACES[4 if len(cells[0]) in (4, 10) else 8]
        flat -= {frozenset(cell[i] for i in face) for cell in cells for face in faces}
    return flat


def _elements(mesh: ET.Element) -> tuple[list[list[int]], list[int], dict[str, list[int]]]:
    """Return nodes and numbers of the solid elements, and those numbers by the name of their part."""
    cells: list[list[int]] = []
    tags: list[int] = []
    blocks: dict[str, list[int]] = {}
    kinds = set()
    for number, part in enumerate(mesh.iter("Elements"), 1):
        text = part.get("type", "").lower()
        if text.startswith(_FLAT):
            continue
        if (match := _KIND.fullmatch(text)) is None:
            raise Fault(f"elements '{shown(text)}' are not supported", f"Elements are {', '.join(_SOLID)}.")
        kind = match[1]
        kinds.add(kind)
        name = part.get("name") or f"part-{number}"
        for element in part:
            nodes = _integers(element)
            if len(nodes) != _SOLID[kind]:
                raise Fault(f"element {_tag(element)} has {len(nodes)} nodes, not {_SOLID[kind]}")
            tags.append(_tag(element))
            cells.append([nodes[place] for place in _COMPLETE] if kind == "hex27" else nodes)
            blocks.setdefault(name, []).append(tags[-1])
    if len(kinds) > 1:
        raise Fault(f"has elements {' and '.join(sorted(kinds))}", "Use one kind of solid elements.")
    if len(set(tags)) < len(tags):
        twice = next(tag for tag, count in Counter(tags).items() if count > 1)
        raise Fault(f"element {twice} is defined twice", "Number the elements again.")
    return cells, tags, blocks


def _row(rows: dict[int, int], tag: int, owner: str) -> int:
    if tag not in rows:
        raise Fault(f"{owner} has node {tag}, which is not defined")
    return rows[tag]


def _name(part: ET.Element) -> str:
    if not (name := part.get("name", "")):
        raise Fault(f"a {part.tag} has no name")
    return name


def _tag(element: ET.Element) -> int:
    try:
        return int(element.get("id", ""))
    except ValueError:
        raise Fault(f"<{element.tag}> has id '{shown(element.get('id', ''))}', not a number") from None


def _position(node: ET.Element) -> list[float]:
    try:
        position = [float(entry) for entry in (node.text or "").split(",")]
    except ValueError:
        position = []
    if len(position) != 3 or not np.isfinite(position).all():
        raise Fault(f"node {_tag(node)} has no three finite coordinates")
    return position


def _integers(element: ET.Element) -> list[int]:
    try:
        return [int(entry) for entry in (element.text or "").replace(",", " ").split()]
    except ValueError:
        raise Fault(
            f"<{element.tag} id='{shown(element.get('id', ''))}'> has entries that are not whole numbers"
        ) from None


def _members(part: ET.Element) -> Iterator[int]:
    """Yield the members of a set: listed in its text (format 4), or one in each element below it."""
    if (part.text or "").strip():
        yield from _integers(part)
    for member in part:
        yield _tag(member)
