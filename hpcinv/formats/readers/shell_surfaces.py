"""Surfaces of shells from files of VTK, from input files of Abaqus and CalculiX, and from files of triangles."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hpcinv.base.mesh_formats.vtu import REGION
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import MeshError
from hpcinv.formats.readers.elements import loose_nodes
from hpcinv.job.mesh_file import SURFACES
from hpcinv.job.mesh_section import ArrayLabels
from hpcinv.mesh.cells import degree_of, no_cells, scalar_element, sub_entities, vertex_count, vtk_order
from hpcinv.mesh.checks import check_nodes
from hpcinv.mesh.io.isolated import Arrays, read_isolated
from hpcinv.mesh.io.vtu import CELL_TAG, NODE_TAG, VTK_TYPES, read_arrays, tags_of, unit_of, whole_numbers, without_tags
from hpcinv.mesh.source import Group, Ints, MeshSource, data_arrays, distinct_tags
from hpcinv.mesh.topology import edge_neighbours, find_rows, unique_rows

_KINDS = ("triangle", "quadrilateral")
_LINES, _POINTS = VTK_TYPES["interval"], (1, 2)
_OF_EIGHT = 23
"""VTK's number of quadrilaterals with 8 nodes; their shape functions give the ninth"""
_OF_ELEMENTS = {3: 5, 6: 22, 4: 9, 8: _OF_EIGHT, 9: 28}
"""VTK's number of an element of Abaqus with the same order of nodes, by their number"""
_NO_ENDS = np.zeros((0, 2), dtype=np.int64)
_CENTRE = np.array([-0.25] * 4 + [0.5] * 4)
"""shape functions of 8 nodes at the centre"""

type _Marks = dict[str, npt.NDArray[np.bool_]]


def read_shell_surface(path: Path, labels: ArrayLabels | None = None) -> list[MeshSource]:
    """Read the cells of each kind, with the same nodes and groups; regions of cells have ``dim`` 3, of edges 2.

    A file of VTK has the cells and lines of a region in an array ``region:NAME``. Nodes of such an array, and node sets
    of an input file, are the region of boundary edges and cells all of whose vertices are in them.

    Args:
        labels: array of integers in cells and lines, or nodes, that has further regions.

    Raises:
        MeshError: the file cannot be read, or has other cells than triangles and quadrilaterals of one degree.
    """
    suffix, notes = suffix_of(path), tuple[str, ...]()
    if suffix == ".inp":
        head, read = read_isolated("inp-shells", path, "cannot be read as an input file", "Is the file complete?")
        arrays = _of_elements(read)
        if head["ignored"]:
            notes = (f"only its mesh is read, not {', '.join(head['ignored'])}",)
    elif suffix in SURFACES and suffix != ".vtk":
        return [_of_triangles(path)]
    else:
        names, arrays = read_arrays(path, suffix.removeprefix("."))
        _check_types(path, names)
    parts, arrays, rows = _cells(path, arrays)
    notes += tuple(loose_nodes(*parts)) if suffix == ".inp" else ()
    on_cells, on_nodes = _regions(path, arrays, labels)
    return [dataclasses.replace(part, notes=notes) for part in _with_groups(parts, rows, arrays, (on_cells, on_nodes))]


def _of_triangles(path: Path) -> MeshSource:
    """Return a surface without groups; its note says by how much flat triangles are bent at their edges."""
    from hpcinv.mesh.io.surface_files import read_triangles  # loads VTK

    surface = read_triangles(path)
    cells = np.asarray(surface.regular_faces, dtype=np.int64)
    points = np.asarray(surface.points, dtype=np.float64)
    source = MeshSource(
        path,
        "triangle",
        1,
        points,
        np.arange(1, len(points) + 1),
        cells,
        np.arange(1, len(cells) + 1),
        no_cells("interval", 1),
    )
    angle = _largest_kink(source)
    note = (
        f"its flat triangles meet at angles of up to {angle:.0f}°, which are kinks of the shell:"
        " cells of degree 2 (.msh, .vtu, .inp) follow a curved surface"
    )
    return dataclasses.replace(source, notes=(note,) if angle > _VISIBLE else ())


_VISIBLE = 1.0
"""degrees between triangles from which a note says so; a flat file of single precision has less"""


def _largest_kink(source: MeshSource) -> float:
    """Return the largest angle (degrees) between two triangles at a common edge."""
    ends = source.cells[:, sub_entities(source.kind, 1)]
    _, place = unique_rows(np.sort(ends.reshape(-1, 2), axis=1))
    one, other, agree = edge_neighbours(ends, place)
    a, b, c = source.points[source.cells].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    cosines = (normals[one] * normals[other]).sum(axis=1) * agree
    return float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).max(initial=0.0))


def _of_elements(read: Arrays) -> Arrays:
    """Return arrays of an input file in VTK's terms; pairs of nodes of edges are ``edges:NAME``."""
    offsets, connectivity = read["offsets"], read["connectivity"]
    sizes = np.diff(offsets)
    arrays: Arrays = {name: read[name] for name in ("points", "offsets", "connectivity")}
    arrays["types"] = np.array([_OF_ELEMENTS[size] for size in sizes.tolist()], dtype=np.int64)
    arrays |= {f"nodes:{NODE_TAG}": read["node_tags"], f"cells:{CELL_TAG}": read["cell_tags"]}
    counts = {"cells": len(sizes), "nodes": len(read["points"])}
    for key, rows in read.items():
        place, separator, name = key.partition(":")
        if not separator:
            continue
        if place == "values":
            arrays[f"nodes:{name}"] = rows[:, None]
            continue
        if place == "faces":
            is_edge = rows[:, 1] >= 0
            cells, edges = rows[is_edge].T
            vertices = np.where(np.isin(sizes[cells], (3, 6)), 3, 4)
            local = np.column_stack([edges, (edges + 1) % vertices])
            arrays[f"edges:{name}"] = connectivity[offsets[cells][:, None] + local]
            place, rows = "cells", rows[~is_edge, 0]
        marks = arrays.setdefault(f"{place}:{REGION}{name}", np.zeros(counts[place], dtype=np.int64))
        marks[rows] = 1
    return arrays


def _check_types(path: Path, names: Mapping[int, str]) -> None:
    """Raise ``MeshError`` for cells that a shell does not have."""
    known = {*_LINES, *_POINTS, _OF_EIGHT, *(number for kind in _KINDS for number in VTK_TYPES[kind])}
    others = sorted(name for number, name in names.items() if number not in known)
    if names.keys() & {number for kind in ("tetrahedron", "hexahedron") for number in VTK_TYPES[kind]}:
        raise MeshError(
            f"{path}: a shell cannot be tied to solid cells, and the file has {' and '.join(others)}",
            "Save the surface alone, or mesh all of it as a solid.",
        )
    if others or not names:
        raise MeshError(
            f"{path}: a shell needs triangles or quadrilaterals of degree 1 or 2, not {' and '.join(others) or 'none'}",
            "Save the surface as such cells, for instance by ParaView's filter 'Triangulate'.",
        )


def _cells(path: Path, arrays: Arrays) -> tuple[list[MeshSource], Arrays, list[Ints]]:
    """Return the cells of each kind, the arrays with nodes of completed quadrilaterals, and the rows of the cells."""
    arrays, found = _found_cells(path, arrays)
    if len({degree for _, degree, _, _ in found}) > 1 or len({kind for kind, *_ in found}) < len(found):
        text = " and ".join(f"{kind}s of {nodes.shape[1]} nodes" for kind, _, _, nodes in found)
        raise MeshError(f"{path}: has {text}", "Save the cells of the shell with one degree and kind of nodes.")
    if not found:
        raise MeshError(f"{path}: has no triangles or quadrilaterals", "Save the surface of the shell.")
    points = np.asarray(arrays["points"], dtype=np.float64)
    node_tags = tags_of(path, NODE_TAG, arrays.get(f"nodes:{NODE_TAG}"), len(points))
    cell_tags = tags_of(path, CELL_TAG, arrays.get(f"cells:{CELL_TAG}"), len(arrays["types"]))
    plain = {key: values for key, values in arrays.items() if not key.startswith(f"nodes:{REGION}")}
    parts = [
        MeshSource(
            path,
            kind,
            degree,
            points,
            node_tags,
            nodes,
            cell_tags[rows],
            no_cells("interval", degree),
            data=data_arrays(without_tags(plain, rows)),
            unit=unit_of(arrays),
        )
        for kind, degree, rows, nodes in found
    ]
    return parts, arrays, [rows for _, _, rows, _ in found]


def _found_cells(path: Path, arrays: Arrays) -> tuple[Arrays, list[tuple[str, int, Ints, Ints]]]:
    """Return the arrays with nodes of completed quadrilaterals, and kind, degree, rows and nodes of like cells."""
    types, start = arrays["types"], arrays["offsets"].astype(np.int64)
    connectivity, sizes = arrays["connectivity"].astype(np.int64), np.diff(start)
    count = len(arrays["points"])
    if connectivity.size and not 0 <= connectivity.min() <= connectivity.max() < count:
        raise MeshError(f"{path}: has cells with nodes that do not exist; it has {count:,} nodes", "Write it again.")
    found = []
    for kind in _KINDS:
        numbers = (*VTK_TYPES[kind], *((_OF_EIGHT,) if kind == "quadrilateral" else ()))
        for size in np.unique(sizes[is_kind := np.isin(types, numbers)]).tolist():
            rows = np.flatnonzero(is_kind & (sizes == size))
            nodes = connectivity[start[rows][:, None] + np.arange(size)]
            if kind == "quadrilateral" and size == 8:
                arrays, nodes = _completed(arrays, nodes)
            degree = degree_of(path, kind, nodes.shape[1])
            found.append((kind, degree, rows, nodes[:, vtk_order(kind, degree)]))
    return arrays, found


def _completed(arrays: Arrays, nodes: Ints) -> tuple[Arrays, Ints]:
    """Return arrays and nodes of quadrilaterals (c, 9) from cells of 8 nodes (c, 8), with their centres."""
    count, completed = len(arrays["points"]), dict(arrays)
    for key, values in arrays.items():
        if key == f"nodes:{NODE_TAG}":
            completed[key] = np.concatenate([values, values.max() + 1 + np.arange(len(nodes))])
        elif key.startswith(f"nodes:{REGION}"):
            completed[key] = np.concatenate([values, np.zeros(len(nodes), dtype=values.dtype)])
        elif key == "points" or key.startswith("nodes:"):
            centres = np.tensordot(_CENTRE, values.astype(np.float64)[nodes], axes=(0, 1))
            completed[key] = np.concatenate([values, centres])
    return completed, np.column_stack([nodes, count + np.arange(len(nodes))])


def _regions(path: Path, arrays: Arrays, labels: ArrayLabels | None) -> tuple[_Marks, _Marks]:
    """Return masks of the regions, on the cells and lines of the file, and on its nodes."""
    counts = {"cells": len(arrays["types"]), "nodes": len(arrays["points"])}
    marks: dict[str, _Marks] = {"cells": {}, "nodes": {}}
    for key, values in arrays.items():
        place, _, name = key.partition(":")
        if place in marks and name.startswith(REGION):
            marks[place][name.removeprefix(REGION)] = whole_numbers(path, name, values, counts[place]) != 0
    if labels is not None:
        _add_labels(path, arrays, labels, marks, counts)
    return marks["cells"], marks["nodes"]


def _add_labels(
    path: Path, arrays: Arrays, labels: ArrayLabels, marks: Mapping[str, _Marks], counts: Mapping[str, int]
) -> None:
    """Add the regions of an array of integers to the masks on cells or nodes."""
    places = [place for place in ("cells", "nodes") if f"{place}:{labels.array}" in arrays]
    if not places:
        known = ", ".join(sorted(key.partition(":")[2] for key in arrays if key.startswith(("cells:", "nodes:"))))
        text = f"{path}: mesh.labels: the mesh has no array '{labels.array}'"
        raise MeshError(text, f"Its arrays are {known or 'none'}.")
    values = whole_numbers(path, labels.array, arrays[f"{places[0]}:{labels.array}"], counts[places[0]])
    distinct = np.unique(values).tolist()
    names: dict[str, Sequence[int]] = dict(labels.names)
    for name, numbers in names.items():
        if missing := [number for number in numbers if number not in distinct]:
            text = f"{path}: mesh.labels.names.{name}: no {places[0]} have the value {missing[0]} of '{labels.array}'"
            raise MeshError(text, f"Its values are {', '.join(map(str, distinct[:12]))}.")
    named = {number for numbers in names.values() for number in numbers}
    names |= {f"{labels.array}-{number}": [number] for number in distinct if number not in named}
    here = marks[places[0]]
    for name, numbers in names.items():
        here[name] = np.isin(values, numbers) | here.get(name, np.zeros(len(values), dtype=bool))


@dataclasses.dataclass(frozen=True)
class _CellEdges:
    """All edges of the cells: sorted ``vertices`` (e, 2), their ``nodes``, and the number of cells at each."""

    vertices: Ints
    nodes: Ints
    sharing: Ints

    @classmethod
    def of_cells(cls, parts: Sequence[MeshSource]) -> "_CellEdges":
        columns = []
        for part in parts:
            local = sub_entities(part.kind, 1)
            if part.degree == 2:
                middles = scalar_element(part.kind, 2).entity_dofs[1]
                local = np.column_stack([local, [middle for (middle,) in middles]])
            columns.append(part.cells[:, local].reshape(-1, local.shape[1]))
        nodes = np.concatenate(columns)
        vertices, place = unique_rows(np.sort(nodes[:, :2], axis=1))
        chosen = np.empty((len(vertices), nodes.shape[1]), dtype=np.int64)
        chosen[place] = nodes
        return cls(vertices, chosen, np.bincount(place, minlength=len(vertices)))

    def find(self, path: Path, name: str, ends: Ints) -> Ints:
        """Rows of edges by their vertices (m, 2); raises ``MeshError`` if a line is not an edge of a cell."""
        rows = find_rows(np.sort(ends, axis=1), self.vertices)
        if (rows < 0).any():
            text = f"{(rows < 0).sum():,} of {len(rows):,} lines of region '{name}' are not edges of its cells"
            raise MeshError(f"{path}: {text}", "Merge nodes at the same place, and save lines and cells together.")
        return rows


def _line_ends(arrays: Arrays, mask: npt.NDArray[np.bool_]) -> Ints:
    """Return the vertices (m, 2) of the lines among the elements of a mask."""
    first = arrays["offsets"].astype(np.int64)[np.flatnonzero(np.isin(arrays["types"], _LINES) & mask)]
    return np.asarray(arrays["connectivity"].astype(np.int64)[first[:, None] + np.arange(2)])


def _with_groups(
    parts: Sequence[MeshSource], rows: Sequence[Ints], arrays: Arrays, marks: tuple[_Marks, _Marks]
) -> Iterator[MeshSource]:
    """Yield the cells of each kind with the groups of all."""
    for part in parts:
        check_nodes(part)
    (on_cells, on_nodes), path, edges = marks, parts[0].path, _CellEdges.of_cells(parts)
    listed = {key.partition(":")[2]: ends for key, ends in arrays.items() if key.startswith("edges:")}
    cells: dict[str, list[Ints]] = {}
    lines, thin = dict[str, Ints](), list[str]()
    unmarked, outside = (np.zeros(len(arrays[name]), dtype=bool) for name in ("types", "points"))
    for name in dict.fromkeys([*on_cells, *on_nodes, *listed]):
        marked, inside = on_cells.get(name, unmarked), on_nodes.get(name, outside)
        is_edge = (edges.sharing == 1) & inside[edges.vertices].all(axis=1)
        for ends in (_line_ends(arrays, marked), listed.get(name, _NO_ENDS)):
            if len(ends):
                is_edge[edges.find(path, name, ends)] = True
        members = [
            np.flatnonzero(marked[here] | inside[part.cells[:, : vertex_count(part.kind)]].all(axis=1))
            for here, part in zip(rows, parts, strict=True)
        ]
        if sum(map(len, members)):
            cells[name] = members
        if is_edge.any():
            lines[name] = np.flatnonzero(is_edge)
        if name not in cells | lines and inside.any():
            thin.append(name)
    used = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *lines.values()]))
    edge_groups = [Group(name, 2, 0, np.searchsorted(used, members)) for name, members in lines.items()]
    for i, part in enumerate(parts):
        groups = [Group(name, 3, 0, members[i]) for name, members in cells.items()]
        yield dataclasses.replace(
            part, facets=edges.nodes[used], groups=distinct_tags([*groups, *edge_groups]), thin_groups=tuple(thin)
        )
