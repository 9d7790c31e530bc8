"""MED files of Salome and code_aster (``.med``, HDF5): nodes, solid cells, and groups of cells, facets and nodes.

Solid cells have the opposite orientation of other programs. Source: *MED file format*, version 3 and 4; node orders:
*Salome MED documentation*, "Numbering of the connectivity".
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.reading.fault import Fault, shown
from hpcinv.base.reading.hdf5_arrays import array_in, group_in, opened
from hpcinv.base.reading.numbered_elements import Blocks, element_arrays, vertices_of

MIRRORED = {
    4: (0, 2, 1, 3),
    10: (0, 2, 1, 3, 6, 5, 4, 7, 9, 8),
    8: (0, 3, 2, 1, 4, 7, 6, 5),
    20: (0, 3, 2, 1, 4, 7, 6, 5, 11, 10, 9, 8, 15, 14, 13, 12, 16, 19, 18, 17),
}
"""places of the nodes of a cell, and of a mirrored one"""
_COMPLETE = (*MIRRORED[20], 26, 20, 25, 24, 23, 22, 21)
"""the same of 27 nodes: bottom, sides by the edges of the bottom, top and centre, read as centre and faces S1 to S6"""
_SOLIDS = {"TE4": 4, "T10": 10, "HE8": 8, "H20": 20, "H27": 27}
_FLAT = {"TR3": 3, "TR6": 6, "TR7": 7, "QU4": 4, "QU8": 8, "QU9": 9}
_OTHERS = ("PE6", "P15", "PY5", "P13", "P18", "POE")
_KINDS = "TETRA4, TETRA10, HEXA8, HEXA20 and HEXA27"


def read_med(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return arrays of nodes, cells and groups; ``ignored`` are fields."""
    with opened(path) as file:
        meshes = group_in(file, "ENS_MAA")
        if len(meshes) != 1:
            raise Fault(f"has {len(meshes)} meshes", "Save one mesh in a file.")
        (name,) = meshes
        steps = group_in(meshes, name)
        step = group_in(steps, min(steps, default=""))
        families = group_in(group_in(file, "FAS"), name) if "FAS" in file and name in file["FAS"] else {}
        nodes = group_in(step, "NOE")
        points = _points(nodes, int(steps.attrs.get("REP", 0)))
        tags = array_in(nodes, "NUM") if "NUM" in nodes else np.arange(1, len(points) + 1)
        blocks, sets = Blocks(), dict[str, list[int]]()
        names = _names(families, "NOEUD")
        if "FAM" in nodes:
            for tag, family in zip(tags.tolist(), array_in(nodes, "FAM").tolist(), strict=False):
                for group in names.get(family, ()):
                    sets.setdefault(f"nodes:{group}", []).append(tag)
        _read_cells(step, tags, _names(families, "ELEME"), blocks, sets)
        ignored = ["fields"] if "CHA" in file and len(file["CHA"]) else []
        ignored += [f"further steps of the mesh ({len(steps) - 1:,})"] if len(steps) > 1 else []
    return {"ignored": ignored}, element_arrays(tags, points, blocks, sets, _KINDS)


def _points(nodes: Any, system: int) -> Any:
    """Return the places of the nodes (n, 3); ``Fault`` in another system of coordinates than 0, the Cartesian one."""
    if system != 0:
        kind = {1: "cylindrical", 2: "spherical"}.get(system, "unknown")
        raise Fault(f"its coordinates are {kind} (REP={system})", "Save the mesh in Cartesian coordinates.")
    flat = array_in(nodes, "COO")
    if flat.ndim != 1 or flat.size % 3:
        raise Fault("its coordinates are not in three dimensions")
    return flat.reshape(3, -1).T


def _read_cells(step: Any, tags: Any, names: dict[int, list[str]], blocks: Blocks, sets: dict[str, list[int]]) -> None:
    kinds = group_in(step, "MAI")
    first = 1
    if other := next((kind for kind in _OTHERS if kind in kinds), None):
        advice = f"Cells are {_KINDS}; mesh by tetrahedra alone or by hexahedra alone."
        raise Fault(f"has cells of the kind {other}", advice)
    for kind, size in (_SOLIDS | _FLAT).items():
        if kind not in kinds:
            continue
        cells = group_in(kinds, kind)
        rows = _nodes_of_cells(array_in(cells, "NOD"), kind, size, len(tags))
        own = _listed(cells, "NUM", range(first, first + len(rows)))
        family = _listed(cells, "FAM", [0] * len(rows))
        if not len(own) == len(family) == len(rows):
            raise Fault(f"cells {kind} and their numbers or families differ in number", "Is the file complete?")
        first += len(rows)
        for tag, member, nodes in zip(own, family, tags[rows - 1].tolist(), strict=True):
            groups = names.get(member, [])
            if kind in _FLAT:
                for group in groups:
                    blocks.skins.setdefault(group, []).append(vertices_of(nodes))
                continue
            blocks.add(tag, [nodes[i] for i in (_COMPLETE if size == 27 else MIRRORED[size])])
            for group in groups:
                sets.setdefault(f"cells:{group}", []).append(tag)


def _listed(cells: Any, name: str, default: Sequence[int]) -> Sequence[int]:
    numbers: Sequence[int] = array_in(cells, name).tolist() if name in cells else default
    return numbers


def _nodes_of_cells(flat: Any, kind: str, size: int, count: int) -> Any:
    """Return the rows of nodes, from 1, of the cells of a kind (m, size)."""
    if flat.ndim != 1 or flat.size % size:
        raise Fault(f"its cells {kind} do not have {size} nodes each", "Is the file complete?")
    if flat.size and not (flat.dtype.kind in "iu" and flat.min() >= 1 and flat.max() <= count):
        raise Fault(f"cells {kind} have nodes that are not defined; there are {count:,}", "Is it complete?")
    return flat.reshape(size, -1).T


def _names(families: Any, kind: str) -> dict[int, list[str]]:
    """Return the names of the groups of each family, by the number of the family."""
    names: dict[int, list[str]] = {}
    part = group_in(families, kind) if kind in families else {}
    for name in part:
        family = group_in(part, name)
        attributes = family.attrs
        if "NUM" not in attributes or "GRO" not in family:
            continue
        rows = array_in(group_in(family, "GRO"), "NOM")
        texts = [bytes(np.asarray(row, dtype=np.uint8)).split(b"\0")[0].decode("utf-8", "replace") for row in rows]
        names[int(attributes["NUM"])] = [shown(text.strip()) for text in texts if text.strip()]
    return names
