"""VTU files: cells, facets of groups as surface cells, an integer array for each region, and data arrays."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hpcinv.base.mesh_formats.vtu import REGION
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.mesh_format import MeshArrays
from hpcinv.errors import MeshError
from hpcinv.mesh.cells import EDGE_KIND, FACET_KIND, degree_of, no_cells, vertex_count, vtk_order
from hpcinv.mesh.facet_groups import facets_of_cells
from hpcinv.mesh.io.isolated import Arrays, read_isolated
from hpcinv.mesh.io.length_unit import FIELD, as_unit
from hpcinv.mesh.io.vtu_writer import Array, Grid, write_vtu
from hpcinv.mesh.source import Floats, Group, Ints, MeshSource, Place, SurfaceCells, data_arrays, distinct_tags
from hpcinv.mesh.topology import FacetTable, find_rows

VTK_TYPES = {
    "interval": (3, 21, 68),
    "triangle": (5, 22, 69),
    "quadrilateral": (9, 28, 70),
    "tetrahedron": (10, 24, 71),
    "hexahedron": (12, 29, 72),
}
"""VTK's numbers of kinds of cells: of degree 1, of degree 2, of any degree; the last two have the same node order."""
_THIN = (1, 3, 4, 21)  # points, edges of degree 1, polygonal lines, and edges of degree 2
NODE_TAG, CELL_TAG = "node_tag", "cell_tag"
OF_VTK = "vtk"  # prefix of names reserved by VTK, such as vtkGhostType


def read_vtu(path: Path) -> MeshSource:
    """Read an unstructured grid; the cells where an array ``region:NAME`` is not 0 are a physical group.

    Other arrays are data. VTK reads the file in a separate process, which may crash on a damaged file.

    Raises:
        MeshError: the file cannot be read, or is not a mesh.
    """
    return read_grid(path, "vtu")


def read_grid(path: Path, action: str) -> MeshSource:
    """Read an unstructured grid by an action of ``hpcinv.base.reading.isolated_reader``."""
    names, arrays = read_arrays(path, action)
    if "types" not in arrays:
        raise MeshError(f"{path}: has no unstructured grid with cells", "Save the mesh as VTU (unstructured grid).")
    return _source(path, names, arrays)


def source_of(path: Path, mesh: MeshArrays) -> MeshSource:
    """Return the mesh of arrays that a format has read; raises ``MeshError`` if they are not one."""
    arrays = {name: getattr(mesh, name) for name in ("points", "types", "offsets", "connectivity")}
    arrays |= {f"cells:{REGION}{name}": marks for name, marks in mesh.regions.items()} | dict(mesh.data)
    return _source(path, {int(number): f"of VTK type {number}" for number in np.unique(mesh.types)}, arrays)


def _source(path: Path, names: Mapping[int, str], arrays: Mapping[str, npt.NDArray[Any]]) -> MeshSource:
    types, points = arrays["types"], np.asarray(arrays["points"], dtype=np.float64)
    kind = _solid_kind(path, names)
    rows = {dim: np.flatnonzero(np.isin(types, VTK_TYPES[k])) for dim, k in ((3, kind), (2, FACET_KIND[kind]))}
    cells = _connectivity(path, arrays, kind, rows[3])
    degree = degree_of(path, kind, cells.shape[1])
    facets = (
        _connectivity(path, arrays, FACET_KIND[kind], rows[2]) if len(rows[2]) else no_cells(FACET_KIND[kind], degree)
    )
    if degree_of(path, FACET_KIND[kind], facets.shape[1]) != degree:
        raise MeshError(f"{path}: surface cells and solid cells are of different degree", "Save both with one degree.")

    groups = []
    for name in arrays:
        if name.startswith(f"cells:{REGION}"):
            marks = whole_numbers(path, name.removeprefix("cells:"), arrays[name], len(types))
            for dim, part in rows.items():
                values = marks[part]
                members = np.flatnonzero(values)
                if len(members):
                    short = name.removeprefix(f"cells:{REGION}")
                    groups.append(Group(short, dim, int(values[members[0]]), members))
    node_tags = tags_of(path, NODE_TAG, arrays.get(f"nodes:{NODE_TAG}"), len(points))
    cell_tags = tags_of(path, CELL_TAG, arrays.get(f"cells:{CELL_TAG}"), len(types))[rows[3]]
    return MeshSource(
        path,
        kind,
        degree,
        points,
        node_tags,
        cells,
        cell_tags,
        *_named(facets, groups),
        data=data_arrays(without_tags(arrays, rows[3])),
        unit=unit_of(arrays),
        surface_cells=_surface_cells(FACET_KIND[kind], facets, node_tags, rows[2], arrays),
    )


def _surface_cells(
    kind: str, facets: Ints, node_tags: Ints, rows: Ints, arrays: Mapping[str, npt.NDArray[Any]]
) -> SurfaceCells | None:
    """Facets with their values of integer arrays; none if there are no such arrays."""
    values = {
        name: array[rows].astype(np.int64)
        for place, _, name in (key.partition(":") for key in arrays)
        if place == "cells" and name != CELL_TAG and not name.startswith((OF_VTK, REGION))
        if (array := arrays[f"cells:{name}"]).ndim == 1 and array.dtype.kind in "iu" and len(rows)
    }
    return SurfaceCells(facets, node_tags[facets[:, : vertex_count(kind)]], values) if values else None


def read_arrays(path: Path, action: str) -> tuple[dict[int, str], dict[str, npt.NDArray[Any]]]:
    """Return names of the cell types in a file by their number, and its arrays: ``points``, …, and data ``nodes:NAME``
    or ``cells:NAME``; raises ``MeshError``."""
    with admitted(path).open("rb"):  # raises OSError if the file cannot be opened
        pass
    remedy = f"Is it a complete .{action} file?{' If so, save it as .vtu.' if action == 'vtk' else ''}"
    head, arrays = read_isolated(action, path, "VTK cannot read it", remedy)
    return {int(number): name for number, name in head["names"].items()}, arrays


def tags_of(path: Path, name: str, values: npt.NDArray[Any] | None, count: int) -> Ints:
    """Return the numbers of nodes or cells, from 1 if the file has none."""
    return np.arange(1, count + 1) if values is None else whole_numbers(path, name, values, count)


def whole_numbers(path: Path, name: str, values: npt.NDArray[Any], count: int) -> Ints:
    """Return values (count,) as integers; raises ``MeshError`` if they are not."""
    if values.shape != (count,) or values.dtype.kind not in "iuf":
        raise MeshError(f"{path}: the array '{name}' is not one number for each entity", "Correct or remove it.")
    with np.errstate(invalid="ignore"):
        whole = values.astype(np.int64)
    if not (whole == values).all():
        raise MeshError(f"{path}: the array '{name}' has values that are not integers", "Correct or remove it.")
    return np.asarray(whole)


def without_tags(
    arrays: Mapping[str, npt.NDArray[Any]], solids: Ints
) -> Iterator[tuple[str, Place, npt.NDArray[np.generic]]]:
    """Yield arrays without a special meaning here or for VTK; rows of cells for the ``solids`` only."""
    for key, values in arrays.items():
        place, _, name = key.partition(":")
        if place == "nodes" and name != NODE_TAG and not name.startswith(OF_VTK):
            yield name, "nodes", values
        elif place == "cells" and name != CELL_TAG and not name.startswith((OF_VTK, REGION)):
            yield name, "cells", values[solids]


def unit_of(arrays: Mapping[str, npt.NDArray[Any]]) -> float | None:
    """Length unit (m) that the file states, or ``None``."""
    stated = arrays.get(f"field:{FIELD}", np.zeros(0))
    return as_unit(float(stated[0])) if stated.shape == (1,) else None


def _solid_kind(path: Path, names: Mapping[int, str]) -> str:
    """Kind of the solid cells among the VTK cell types of a file; raises ``MeshError`` if there is not exactly one."""
    flat = {*_THIN, *(number for kind in FACET_KIND.values() for number in VTK_TYPES[kind])}
    solid = {number: next((k for k in FACET_KIND if number in VTK_TYPES[k]), None) for number in names.keys() - flat}
    kinds = set(solid.values())
    if len(kinds) == 1 and (kind := kinds.pop()) is not None:
        return kind
    if not solid:
        raise MeshError(
            f"{path}: no solid cells",
            "Save the tetrahedra or hexahedra of the body, or make it a shell: 'mesh: {shell: {thickness: …}}'.",
        )
    raise MeshError(
        f"{path}: cells are {' and '.join(sorted(names[number] for number in solid))}",
        "Use one kind of cell in a mesh: all tetrahedra (4 or 10 nodes) or all hexahedra (8 or 27 nodes;"
        " .inp and .unv may have 20).",
    )


def _connectivity(path: Path, arrays: Mapping[str, npt.NDArray[Any]], kind: str, rows: Ints) -> Ints:
    start = arrays["offsets"].astype(np.int64)
    sizes = np.unique(start[rows + 1] - start[rows])
    if len(sizes) > 1:
        raise MeshError(f"{path}: {kind}s of {' and '.join(map(str, sizes))} nodes", "Save them all with one degree.")
    size = int(sizes[0])
    nodes: Ints = arrays["connectivity"].astype(np.int64)[start[rows][:, None] + np.arange(size)]
    return nodes[:, vtk_order(kind, degree_of(path, kind, size))]


def _named(facets: Ints, groups: list[Group]) -> tuple[Ints, tuple[Group, ...]]:
    """Facets that are in a group, and the groups with indices of these."""
    named = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *(g.members for g in groups if g.dim == 2)]))
    kept = [g if g.dim == 3 else Group(g.name, 2, g.tag, np.searchsorted(named, g.members)) for g in groups]
    return facets[named], distinct_tags(kept)


def save_vtu(path: Path, source: MeshSource, points: Floats) -> None:
    """Write topology, tags, groups and data of ``source`` at ``points`` (n, 3) in ``source.unit``; not collective.

    Raises:
        OSError: it cannot be written.
    """
    cells, node_arrays, cell_arrays, fields = content_of(source)
    error = write_vtu(
        path,
        MPI.COMM_SELF,
        Grid(points, cells),
        [Array(name, values) for name, values in node_arrays.items()],
        [Array(name, values) for name, values in cell_arrays.items()],
        fields,
    )
    if error is not None:
        raise error


def content_of(source: MeshSource) -> tuple[list[tuple[Ints, int]], Arrays, Arrays, dict[str, float]]:
    """Return nodes and VTK's type of the cells and facets, arrays at nodes and in cells, and fields."""
    facets, labels = _labelled_facets(source)
    cells = [
        (nodes[:, np.argsort(vtk_order(kind, source.degree))], VTK_TYPES[kind][source.degree - 1])
        for kind, nodes in ((source.kind, source.cells), ((FACET_KIND | EDGE_KIND)[source.kind], facets))
    ]
    node_arrays: dict[str, npt.NDArray[Any]] = {}
    cell_arrays: dict[str, npt.NDArray[Any]] = {}
    for name, data in source.data.items():  # before the arrays below, which replace data arrays of the same name
        values = data.values.astype(np.int64) if data.is_integer else data.values
        if data.place == "nodes":
            node_arrays[name] = values
        elif data.is_integer and values.shape[1] == 1:
            no_label = np.full(len(facets), min(0, int(values.min(initial=0)) - 1))
            cell_arrays[name] = np.concatenate([values[:, 0], labels.get(name, no_label)])
        else:
            facet_values = np.full((len(facets), values.shape[1]), np.nan)
            cell_arrays[name] = np.concatenate([values, facet_values])
    node_arrays[NODE_TAG] = source.node_tags
    facet_tags = source.cell_tags.max() + 1 + np.arange(len(facets))
    cell_arrays[CELL_TAG] = np.concatenate([source.cell_tags, facet_tags])
    for group in source.groups:
        marks = cell_arrays.setdefault(REGION + group.name, np.zeros(len(cell_arrays[CELL_TAG]), dtype=np.int32))
        marks[group.members + (0 if group.dim == 3 else len(source.cells))] = group.tag
    return cells, node_arrays, cell_arrays, {FIELD: source.unit or 1.0}


def _labelled_facets(source: MeshSource) -> tuple[Ints, Mapping[str, Ints]]:
    """Return facets (f, l), the mesh's own first, and integers (f,) in them by name of the array.

    The others are surface cells of the file without a group. A facet that the file does not have gets a number that is
    below those in the file, at most -1. Surface cells that are not facets of the cells are left out.
    """
    labelled = source.surface_cells
    if labelled is None:
        return source.facets, {}
    vertices = source.cells[:, : vertex_count(source.kind)]
    table = FacetTable.build(source.kind, vertices)
    corners = find_rows(labelled.vertex_tags.reshape(-1, 1), source.node_tags[:, None])
    row_of_label = table.find(corners.reshape(labelled.vertex_tags.shape))
    row_of_facet = table.find(source.facets[:, : labelled.vertex_tags.shape[1]])
    more = np.setdiff1d(row_of_label[row_of_label >= 0], row_of_facet)
    facets = np.concatenate([source.facets, facets_of_cells(source, table.owners(more))])
    rows, is_known = np.concatenate([row_of_facet, more]), row_of_label >= 0
    labels = dict[str, Ints]()
    for name, values in labelled.values.items():
        row_labels = np.full(len(table.vertices), min(-1, int(values.min()) - 1))
        row_labels[row_of_label[is_known]] = values[is_known]
        labels[name] = row_labels[rows]
    return facets, labels
