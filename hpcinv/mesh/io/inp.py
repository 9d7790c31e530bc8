"""Meshes in input files of Abaqus and CalculiX, read and written.

Node sets become regions of the boundary facets and cells all of whose vertices are in them. Elements of 20 nodes are
completed to 27 by the shape functions of 20 nodes, which leaves their geometry as it is.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hpcinv.errors import MeshError
from hpcinv.mesh.cells import node_order, scalar_element, vertex_count
from hpcinv.mesh.facet_groups import add_facets
from hpcinv.mesh.io.isolated import read_isolated
from hpcinv.mesh.source import Floats, Group, Ints, MeshSource, distinct_tags
from hpcinv.mesh.topology import FacetTable, unique_rows
from hpcinv.reading.inp_files import FACES

_CORNERS = {
    "tetrahedron": np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]),
    "hexahedron": np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1.0]]),
}
"""reference coordinates of the vertices of an element, in its order"""
_EDGES = {
    "tetrahedron": ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)),
    "hexahedron": (
        *((0, 1), (1, 2), (2, 3), (3, 0)),
        *((4, 5), (5, 6), (6, 7), (7, 4)),
        *((0, 4), (1, 5), (2, 6), (3, 7)),
    ),
}
"""vertices of the edges whose middle nodes follow the vertices"""
_NAMES = {
    ("tetrahedron", 1): "C3D4",
    ("tetrahedron", 2): "C3D10",
    ("hexahedron", 1): "C3D8",
    ("hexahedron", 2): "C3D20",
}
_PER_LINE = 16
"""numbers in a line of a set, the most that Abaqus reads"""


def read_inp(path: Path) -> MeshSource:
    """Read nodes, solid elements, sets and surfaces; materials, loads and steps are not used.

    Raises:
        MeshError: the file cannot be read, or is not a mesh.
    """
    _, arrays = read_isolated("inp", path, "cannot be read as an input file", "Is the file complete?")
    cells, points = arrays["cells"], arrays["points"]
    kind = "tetrahedron" if cells.shape[1] in (4, 10) else "hexahedron"
    degree = 1 if cells.shape[1] in (4, 8) else 2
    tags = arrays["node_tags"]
    if cells.shape[1] == 20:
        cells, points, tags = _completed(cells, points, tags)
    elif cells.shape[1] == 27:  # the centre comes before the faces
        cells = cells[:, [*range(20), *range(21, 27), 20]]
    order = node_order(kind, degree, _reference_nodes(kind)[: cells.shape[1]])
    source = MeshSource(
        path,
        kind,
        degree,
        points,
        tags,
        cells[:, order],
        arrays["cell_tags"],
        np.zeros((0, _facet_nodes(kind, degree)), dtype=np.int64),
    )
    return _with_sets(source, arrays, cells)


def _facet_nodes(kind: str, degree: int) -> int:
    return len(scalar_element(kind, degree).entity_closure_dofs[2][0])


def _reference_nodes(kind: str) -> Floats:
    """Reference coordinates of the nodes of an element: vertices, middles of edges and of faces, and the centre."""
    corners = _CORNERS[kind]
    edges = [corners[list(edge)].mean(axis=0) for edge in _EDGES[kind]]
    if kind == "tetrahedron":
        return np.array([*corners, *edges])
    faces = [corners[list(face)].mean(axis=0) for face in FACES[8]]
    return np.array([*corners, *edges, *faces, corners.mean(axis=0)])


def _completed(cells: Ints, points: Floats, tags: Ints) -> tuple[Ints, Floats, Ints]:
    """Return hexahedra of 20 nodes with nodes in the middle of faces and cells, where 20 nodes have these points."""
    edges = [frozenset(edge) for edge in _EDGES["hexahedron"]]
    faces = np.array(FACES[8])
    middles = np.array(
        [[8 + edges.index(frozenset((face[i], face[(i + 1) % 4]))) for i in range(4)] for face in FACES[8]]
    )
    distinct, place = unique_rows(np.sort(cells[:, faces].reshape(-1, 4), axis=1))
    owner = np.zeros(len(distinct), dtype=np.int64)
    owner[place] = np.arange(len(place))
    cell, face = np.divmod(owner, len(faces))
    corner, middle = (points[cells[cell[:, None], local[face]]].sum(axis=1) for local in (faces, middles))
    centres = points[cells[:, 8:]].sum(axis=1) / 4 - points[cells[:, :8]].sum(axis=1) / 4
    first = len(points)
    wide = np.column_stack(
        [cells, first + place.reshape(-1, len(faces)), first + len(distinct) + np.arange(len(cells))]
    )
    more = np.concatenate([middle / 2 - corner / 4, centres])
    new_tags = tags.max() + 1 + np.arange(len(more))
    return wide, np.concatenate([points, more]), np.concatenate([tags, new_tags])


def _with_sets(source: MeshSource, arrays: dict[str, Ints], elements: Ints) -> MeshSource:
    """Return the mesh with a group for each set and surface; ``elements`` have the order of the file."""
    vertices = source.cells[:, : vertex_count(source.kind)]
    table = FacetTable.build(source.kind, vertices)
    local = np.array(FACES[vertices.shape[1]])
    groups, sides = list[Group](), dict[str, Ints]()
    for key, rows in arrays.items():
        place, separator, name = key.partition(":")
        if not separator or (place == "nodes" and f"faces:{name}" in arrays):  # the surface is exact
            continue
        if place == "cells":
            groups.append(Group(name, 3, 0, rows))
            continue
        is_facet = np.zeros(len(table.vertices), dtype=bool)
        if place == "faces":
            is_facet[table.find(elements[rows[:, 0, None], local[rows[:, 1]]])] = True
        else:
            is_inside = np.zeros(len(source.points), dtype=bool)
            is_inside[rows] = True
            inner = np.flatnonzero(is_inside[vertices].all(axis=1))
            is_facet = (table.sharing == 1) & is_inside[table.vertices].all(axis=1)
            if len(inner) and name not in {group.name for group in groups}:
                groups.append(Group(name, 3, 0, inner))
        if is_facet.any():
            owner = np.argwhere(is_facet[table.cell_facets])
            _, first = np.unique(table.cell_facets[owner[:, 0], owner[:, 1]], return_index=True)
            before = sides.get(name, np.zeros((0, 2), dtype=np.int64))
            sides[name] = np.unique(np.concatenate([before, owner[first]]), axis=0)
    return add_facets(dataclasses.replace(source, groups=distinct_tags(groups)), sides)


def save_inp(path: Path, source: MeshSource, points: Floats) -> None:
    """Write nodes, elements, sets and surfaces at ``points`` (n, 3); hexahedra of degree 2 as C3D20.

    A region of facets is a surface, and a node set of the same name.

    Raises:
        OSError: it cannot be written.
    """
    theirs = _reference_nodes(source.kind)[: source.cells.shape[1]]
    elements = source.cells[:, np.argsort(node_order(source.kind, source.degree, theirs))]
    if elements.shape[1] == 27:
        elements = elements[:, :20]
    if bad := [group.name for group in source.groups if set(group.name) & set(',"\n') or not group.name.strip()]:
        raise MeshError(f"the name '{bad[0]}' is not possible in this format", "Rename the region.")
    tags, used = source.node_tags, np.unique(elements)
    with path.open("w", encoding="utf-8") as file:
        file.write("*HEADING\nWritten by hpcinv\n*NODE\n")
        file.writelines(
            f"{tag}, {x!r}, {y!r}, {z!r}\n"
            for tag, (x, y, z) in zip(tags[used].tolist(), points[used].tolist(), strict=True)
        )
        file.write(f"*ELEMENT, TYPE={_NAMES[source.kind, source.degree]}\n")
        for tag, nodes in zip(source.cell_tags.tolist(), tags[elements].tolist(), strict=True):
            file.writelines(_lines([tag, *nodes]))
        for group in source.groups:
            if group.dim == 3:
                file.write(f"*ELSET, ELSET={group.name}\n")
                file.writelines(_rows(source.cell_tags[group.members].tolist()))
            else:
                file.write(f"*SURFACE, NAME={group.name}, TYPE=ELEMENT\n")
                file.writelines(f"{cell}, S{face}\n" for cell, face in _faces(source, group, elements))
                file.write(f"*NSET, NSET={group.name}\n")
                file.writelines(_rows(tags[np.intersect1d(source.facets[group.members], used)].tolist()))


def _rows(numbers: list[int]) -> Iterator[str]:
    """Yield lines of a set."""
    for start in range(0, len(numbers), _PER_LINE):
        yield f"{', '.join(map(str, numbers[start : start + _PER_LINE]))}\n"


def _lines(numbers: list[int]) -> Iterator[str]:
    """Yield lines of an element; all but the last end with a comma."""
    for start in range(0, len(numbers), _PER_LINE):
        part = ", ".join(map(str, numbers[start : start + _PER_LINE]))
        yield f"{part},\n" if start + _PER_LINE < len(numbers) else f"{part}\n"


def _faces(source: MeshSource, group: Group, elements: Ints) -> Iterator[tuple[int, int]]:
    """Yield element and number of the face of each facet of a group."""
    local = np.array(FACES[vertex_count(source.kind)])
    every, place = unique_rows(np.sort(elements[:, local].reshape(-1, local.shape[1]), axis=1))
    owner = np.zeros(len(every), dtype=np.int64)
    owner[place[::-1]] = np.arange(len(place))[::-1]
    facets = np.sort(source.facets[group.members][:, : local.shape[1]], axis=1)
    table = FacetTable(every, np.zeros(0, dtype=np.int64), np.zeros((0, 0), dtype=np.int64))
    for cell, face in zip(*np.divmod(owner[table.find(facets)], len(local)), strict=True):
        yield int(source.cell_tags[cell]), int(face) + 1
