"""XDMF meshes as written by DOLFINx: a grid of cells, a grid for each set of mesh tags, and functions as data."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hpcinv.base.files.names import is_file
from hpcinv.base.mesh_formats.xdmf import IN_FILE, mesh_grids, root_of
from hpcinv.base.reading.door import admitted
from hpcinv.errors import MeshError
from hpcinv.mesh.cells import FACET_KIND, degree_of, no_cells, vtk_order
from hpcinv.mesh.source import DataArray, Group, Ints, MeshSource, Place, data_arrays
from hpcinv.mesh.topology import find_rows

KIND_OF = {"tet": "tetrahedron", "hex": "hexahedron", "tri": "triangle", "qua": "quadrilateral"}
MOST_COMPRESSED = 1100  # largest ratio of compression; zlib reaches 1032
PLACES: dict[str, Place] = {"Node": "nodes", "Cell": "cells"}


def _root(path: Path) -> ET.Element:
    try:
        return root_of(path)
    except ValueError as exc:
        raise MeshError(f"{path}: is not valid XML: {exc}", "Is it a complete .xdmf file?") from exc


def read_xdmf(path: Path) -> MeshSource:
    """Read the first mesh of the file; tags NAME with a value V become the physical group ``NAME-V``.

    Tags are the first attribute on the cells of a grid; in the grid of the mesh, the first attribute of integers. Other
    attributes of the mesh, and functions on it, are data; functions of time at their last time.
    """
    root = _root(path)
    grids = mesh_grids(root)
    mesh = next((g for g in grids if g.find("Geometry/DataItem") is not None), None)
    if mesh is None:
        raise MeshError(f"{path}: has no grid with a topology and a geometry", "Write one with dolfinx.io.XDMFFile.")
    kind, cells, points = _body(path, mesh)
    degree = degree_of(path, kind, cells.shape[1])
    marked = [a for a in mesh.findall("Attribute[@Center='Cell']") if _is_tags(path, a, len(cells))]
    whole = marked[0] if marked else None
    markers = ((grid, whole if grid is mesh else grid.find("Attribute[@Center='Cell']")) for grid in grids)
    facets, groups = _groups(path, markers, kind, degree, cells)
    cell_tags, node_tags = np.arange(1, len(cells) + 1), np.arange(1, len(points) + 1)
    grids = [mesh, *(g for g in root.findall("Domain/Grid/Grid") if g.find("Topology") is None)]
    return MeshSource(
        path,
        kind,
        degree,
        points,
        node_tags,
        cells,
        cell_tags,
        facets,
        groups,
        data=_arrays(path, grids, whole, {"nodes": len(points), "cells": len(cells)}),
    )


def _groups(
    path: Path, markers: Iterable[tuple[ET.Element, ET.Element | None]], kind: str, degree: int, cells: Ints
) -> tuple[Ints, tuple[Group, ...]]:
    """Return the nodes of facets, and the groups of facets and cells, from grids and their attributes of tags."""
    facets, groups = [no_cells(FACET_KIND[kind], degree)], list[Group]()
    for grid, marker in markers:
        values = None if marker is None else marker.find("DataItem")
        entity_kind, entities = _topology(path, grid)
        if values is None or entity_kind not in (kind, FACET_KIND[kind]):
            continue
        name, dim = grid.get("Name", "tags"), 3 if entity_kind == kind else 2
        tags = _tags(path, name, values, (entity_kind, entities), degree)
        if dim == 3:
            rows = _cell_rows(path, name, entities, cells)
        else:
            rows = np.arange(len(entities)) + sum(map(len, facets))
            facets.append(entities)
        for number, value in enumerate(np.unique(tags), len(groups) + 1):
            groups.append(Group(f"{name}-{int(value)}", dim, number, rows[tags == value]))
    return np.concatenate(facets), tuple(groups)


def _body(path: Path, mesh: ET.Element) -> tuple[str, Ints, npt.NDArray[np.float64]]:
    """Return kind and nodes of the cells, and points."""
    kind, cells = _topology(path, mesh)
    if kind not in FACET_KIND:
        raise MeshError(f"{path}: cells are {kind}s", "Use a mesh of tetrahedra or hexahedra.")
    points = _data(path, mesh.find("Geometry/DataItem")).astype(np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise MeshError(f"{path}: nodes do not have three coordinates", "Use a mesh in three dimensions.")
    return kind, cells, points


def _tags(path: Path, name: str, values: ET.Element, entities: tuple[str, Ints], degree: int) -> npt.NDArray[Any]:
    """Return the tags of entities, which are given by kind and nodes, of a mesh of a degree."""
    count, width = entities[1].shape
    if degree_of(path, entities[0], width) != degree:
        raise MeshError(f"{path}: tags and mesh are of different degree", "Write the tags with the mesh's geometry.")
    tags = _data(path, values).ravel()
    if not np.isfinite(tags.astype(np.float64)).all() or np.abs(tags.astype(np.float64)).max(initial=0.0) > 2.0**53:
        raise MeshError(f"{path}: '{name}' has tags that are not finite numbers below 2^53", "Correct the tags.")
    if len(tags) != count:
        raise MeshError(f"{path}: '{name}' has {len(tags)} tags for {count} entities", "Is the file complete?")
    return tags


def _cell_rows(path: Path, name: str, tagged: Ints, cells: Ints) -> Ints:
    """Return the rows of tagged cells among the cells of the mesh."""
    rows = find_rows(np.sort(tagged, axis=1), np.sort(cells, axis=1))
    if (rows < 0).any():
        raise MeshError(f"{path}: '{name}' has cells that are not in the mesh", "Write the tags with this mesh.")
    return rows


def _is_tags(path: Path, attribute: ET.Element, cells: int) -> bool:
    values = _data(path, attribute.find("DataItem"))
    return values.dtype.kind in "iu" and values.size == cells


def _arrays(
    path: Path, grids: list[ET.Element], tags: ET.Element | None, sizes: Mapping[Place, int]
) -> dict[str, DataArray]:
    """Attributes of grids, except tags, with a row for each node or cell."""
    attributes = [a for grid in grids for a in grid.findall("Attribute") if a is not tags]
    items = {
        (a.get("Name", ""), PLACES[center]): a.find("DataItem")
        for a in attributes
        if (center := a.get("Center", "Node")) in PLACES
    }
    values = ((name, place, _data(path, item)) for (name, place), item in items.items())
    return data_arrays((name, place, rows) for name, place, rows in values if rows.ndim and len(rows) == sizes[place])


def _topology(path: Path, grid: ET.Element) -> tuple[str, Ints]:
    """Kind of the cells of a grid, and their nodes in DOLFINx order."""
    topology = grid.find("Topology")
    assert topology is not None
    name = topology.get("TopologyType") or topology.get("Type") or ""
    kind = KIND_OF.get(name[:3].lower())
    if kind is None:
        raise MeshError(
            f"{path}: cells are '{name}'",
            "Save tetrahedra or hexahedra alone, or solid cells and surface together as .vtu.",
        )
    nodes = _data(path, topology.find("DataItem"))
    if nodes.ndim != 2 or nodes.dtype.kind not in "iu":
        raise MeshError(
            f"{path}: the topology is not an integer table with a row for each cell", "Write the mesh again."
        )
    rows = nodes.astype(np.int64)
    return kind, rows[:, vtk_order(kind, degree_of(path, kind, rows.shape[1]))]


def _data(path: Path, item: ET.Element | None) -> npt.NDArray[np.generic]:
    """Values of a data item, inline or in an HDF5 file next to the XDMF file."""
    text = "" if item is None else (item.text or "").strip()
    form = "" if item is None else item.get("Format", "XML")
    if form == "XML" and item is not None:
        return _inline(path, item, text)
    if form != "HDF":
        raise MeshError(f"{path}: data in the format '{form}'", "HDF and XML are supported.")
    match = IN_FILE.fullmatch(text)
    if match is None:
        raise MeshError(f"{path}: '{text[:80]}' is not of the form FILE:/DATASET", "Write the mesh again.")
    file_of, dataset = path.parent / match[1], match[2]
    if not is_file(file_of):
        raise MeshError(f"{path}: there is no file '{file_of}'", "Keep the .h5 file next to the .xdmf file.")
    try:
        return _stored(path, file_of, dataset, text[:80])
    except (OSError, KeyError, RuntimeError, ValueError, TypeError) as exc:
        reason = str(exc).partition(", flags =")[0]
        raise MeshError(f"{path}: {text[:80]} cannot be read: {reason}", "Is the .h5 file complete?") from exc


def _stored(path: Path, file_of: Path, dataset: str, named: str) -> npt.NDArray[np.generic]:
    """Return the array of an HDF5 file that a data item names."""
    import h5py  # here, since few runs need it

    with h5py.File(admitted(file_of, path)) as file:
        stored = file[dataset]
        if not isinstance(stored, h5py.Dataset) or stored.dtype.kind not in "iuf":
            raise MeshError(f"{path}: {named} is not an array of numbers", "Write the mesh again.")
        if stored.size * stored.dtype.itemsize > MOST_COMPRESSED * file_of.stat().st_size:
            raise MeshError(f"{path}: {named} has a shape that is too large for the file", "Write the mesh again.")
        return np.asarray(stored)


def _inline(path: Path, item: ET.Element, text: str) -> npt.NDArray[np.generic]:
    dimensions = item.get("Dimensions", "")
    declared = item.get("NumberType", item.get("DataType", "Float"))
    kind = np.dtype(np.int64 if declared in ("Int", "UInt") else np.float64)
    numbers = text.split()
    try:
        shape = tuple(int(n) for n in dimensions.split())
        if min(shape, default=0) < 0 or math.prod(shape) != len(numbers):
            text = f"has {len(numbers)} numbers, but its Dimensions are '{dimensions[:40]}'"
            raise MeshError(f"{path}: a DataItem {text}", "Is the file complete?")
        return np.array(numbers, dtype=kind).reshape(shape)
    except (ValueError, OverflowError) as exc:
        what = "integers" if kind.kind == "i" else "numbers"
        raise MeshError(
            f"{path}: a DataItem has values that are not {what}: {str(exc)[:100]}", "Is the file complete?"
        ) from exc
