"""XDMF meshes as DOLFINx writes them: one grid of cells, a grid for each set of mesh tags, and functions as data."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hpcinv.errors import MeshError
from hpcinv.mesh.cells import FACET_KIND, degree_of, no_cells, vtk_order
from hpcinv.mesh.source import DataArray, Group, Ints, MeshSource, Place, data_arrays
from hpcinv.mesh.topology import find_rows

KIND_OF = {"tet": "tetrahedron", "hex": "hexahedron", "tri": "triangle", "qua": "quadrilateral"}
PLACES: dict[str, Place] = {"Node": "nodes", "Cell": "cells"}


def read_xdmf(path: Path) -> MeshSource:
    """Read the first mesh of the file; tags called NAME with a value V become the physical group ``NAME-V``.

    Tags are the first attribute on the cells of a grid, and in that of the mesh the first one of integers. The other
    attributes of the mesh, and functions on it, are data; functions of time at their last time.
    """
    try:
        root = ET.parse(path).getroot()
        grids = [g for g in root.findall("Domain/Grid") if g.find("Topology") is not None]
    except ET.ParseError as exc:
        raise MeshError(f"{path}: no XML: {exc}", "Is it a whole .xdmf file?") from exc
    mesh = next((g for g in grids if g.find("Geometry/DataItem") is not None), None)
    if mesh is None:
        raise MeshError(f"{path}: no grid with a topology and a geometry", "Write one with dolfinx.io.XDMFFile.")
    kind, cells = _topology(path, mesh)
    if kind not in FACET_KIND:
        raise MeshError(f"{path}: cells are {kind}s", "A body of tetrahedra or hexahedra is needed.")
    points = _data(path, mesh.find("Geometry/DataItem")).astype(np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise MeshError(f"{path}: the coordinates are not three to a node", "A body in three dimensions is needed.")

    degree = degree_of(path, kind, cells.shape[1])
    facets = [no_cells(FACET_KIND[kind], degree)]
    groups: list[Group] = []
    whole = next((a for a in mesh.findall("Attribute[@Center='Cell']") if _is_tags(path, a, len(cells))), None)
    for grid in grids:
        marker = whole if grid is mesh else grid.find("Attribute[@Center='Cell']")
        values = None if marker is None else marker.find("DataItem")
        on, entities = _topology(path, grid)
        if values is None or on not in (kind, FACET_KIND[kind]):
            continue
        if degree_of(path, on, entities.shape[1]) != degree:
            raise MeshError(
                f"{path}: tags and mesh are of different degree", "Write the tags with the mesh's geometry."
            )
        if on == kind:
            rows = find_rows(np.sort(entities, axis=1), np.sort(cells, axis=1))
        else:
            rows = np.arange(len(entities)) + sum(map(len, facets))
            facets.append(entities)
        tags = _data(path, values).ravel()
        for value in np.unique(tags):
            name = f"{grid.get('Name', 'tags')}-{int(value)}"
            groups.append(Group(name, 3 if on == kind else 2, len(groups) + 1, rows[tags == value]))
    cell_tags, node_tags = np.arange(1, len(cells) + 1), np.arange(1, len(points) + 1)
    of_functions = [g for g in root.findall("Domain/Grid/Grid") if g.find("Topology") is None]
    attributes = [a for g in (mesh, *of_functions) for a in g.findall("Attribute") if a is not whole]
    return MeshSource(
        path,
        kind,
        degree,
        points,
        node_tags,
        cells,
        cell_tags,
        np.concatenate(facets),
        tuple(groups),
        data=_arrays(path, attributes, {"nodes": len(points), "cells": len(cells)}),
    )


def _is_tags(path: Path, attribute: ET.Element, cells: int) -> bool:
    values = _data(path, attribute.find("DataItem"))
    return values.dtype.kind in "iu" and values.size == cells


def _arrays(path: Path, attributes: list[ET.Element], sizes: Mapping[Place, int]) -> dict[str, DataArray]:
    """The attributes that have a row for each node or cell."""
    found = {
        (a.get("Name", ""), PLACES[center]): a.find("DataItem")
        for a in attributes
        if (center := a.get("Center", "Node")) in PLACES
    }
    values = ((name, on, _data(path, item)) for (name, on), item in found.items())
    return data_arrays((name, on, rows) for name, on, rows in values if rows.ndim and len(rows) == sizes[on])


def _topology(path: Path, grid: ET.Element) -> tuple[str, Ints]:
    """Kind of the grid's cells, and their nodes in DOLFINx order."""
    topology = grid.find("Topology")
    assert topology is not None
    name = topology.get("TopologyType") or topology.get("Type") or ""
    kind = KIND_OF.get(name[:3].lower())
    if kind is None:
        raise MeshError(f"{path}: cells are '{name}'", "One kind is supported in a mesh: tetrahedra or hexahedra.")
    nodes = _data(path, topology.find("DataItem")).astype(np.int64)
    return kind, nodes[:, vtk_order(kind, degree_of(path, kind, nodes.shape[1]))]


def _data(path: Path, item: ET.Element | None) -> npt.NDArray[np.generic]:
    """Values of a data item, inline or in an HDF5 file beside the XDMF file."""
    text = "" if item is None else (item.text or "").strip()
    form = "" if item is None else item.get("Format", "XML")
    if form == "XML" and item is not None:
        shape = [int(n) for n in item.get("Dimensions", "").split()]
        declared = item.get("NumberType", item.get("DataType", "Float"))
        return np.array(text.split(), dtype=np.int64 if declared in ("Int", "UInt") else np.float64).reshape(shape)
    if form != "HDF":
        raise MeshError(f"{path}: data in the format '{form}'", "HDF and XML are supported.")
    match = re.fullmatch(r"(.+?):(/.+)", text)
    if match is None:
        raise MeshError(f"{path}: '{text}' is no FILE:/DATASET", "Write the mesh anew.")
    try:
        import h5py  # where it is needed, so that not all ranks of all runs read it

        with h5py.File(path.parent / match[1]) as file:
            return np.asarray(file[match[2]])
    except (OSError, KeyError) as exc:
        raise MeshError(f"{path}: {text} cannot be read: {exc}", "Keep the .h5 file beside the .xdmf file.") from exc
