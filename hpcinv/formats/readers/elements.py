"""Meshes by elements, node sets, element sets and surfaces, as input files of other programs have them.

Node sets become regions of the boundary facets and cells all of whose vertices are in them. Elements of 20 nodes are
completed to 27 by the shape functions of 20 nodes, which leaves their geometry as it is.
"""

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hpcinv.base.reading.element_faces import FACES
from hpcinv.base.reading.mesh_format import OF_NODES
from hpcinv.errors import MeshError
from hpcinv.mesh.cells import node_order, scalar_element, vertex_count
from hpcinv.mesh.facet_groups import add_facets, facets_and_cells_inside
from hpcinv.mesh.io.isolated import read_isolated
from hpcinv.mesh.source import DataArray, Floats, Group, Ints, MeshSource, distinct_tags
from hpcinv.mesh.topology import FacetTable, unique_rows

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


def read_elements(path: Path, action: str, failure: str) -> MeshSource:
    """Return the mesh of a file by an action of ``hpcinv.base.reading.isolated_reader``; `read_isolated` says more."""
    head, arrays = read_isolated(action, path, failure, "Is the file complete?")
    return _source_of_elements(path, arrays, head["ignored"])


def _source_of_elements(path: Path, arrays: Mapping[str, npt.NDArray[Any]], ignored: Sequence[str]) -> MeshSource:
    """Return the mesh of nodes, elements and sets.

    Args:
        arrays: ``points`` (n, 3), ``node_tags`` (n,), ``cells`` (m, k), ``cell_tags`` (m,), and sets by their names:
            ``cells:NAME`` and ``nodes:NAME`` (rows), ``faces:NAME`` (cell, face), ``facets:NAME`` (vertices of each),
            ``skin:NAME`` (the same of surface elements, which need not be facets of the cells); ``values:NAME`` (m, 3)
            are an array in the cells.
        ignored: parts of the file that are not read.
    """
    cells, points, tags = arrays["cells"], arrays["points"], arrays["node_tags"]
    kind = "tetrahedron" if cells.shape[1] in (4, 10) else "hexahedron"
    degree = 1 if cells.shape[1] in (4, 8) else 2
    notes = [f"only its mesh is read, not {', '.join(ignored)}"] if ignored else []
    if cells.shape[1] == 20:
        cells, points, tags = _completed(cells, points, tags)
        notes.append("its elements of 20 nodes were completed to 27")
    elif cells.shape[1] == 27:  # the centre comes before the faces
        cells = cells[:, [*range(20), *range(21, 27), 20]]
    order = node_order(kind, degree, _reference_nodes(kind)[: cells.shape[1]])
    no_facets = np.zeros((0, len(scalar_element(kind, degree).entity_closure_dofs[2][0])), dtype=np.int64)
    source = MeshSource(
        path,
        kind,
        degree,
        points,
        tags,
        cells[:, order],
        arrays["cell_tags"],
        no_facets,
        data={
            name: DataArray(name, "cells", values)
            for key, values in arrays.items()
            if (name := key.removeprefix("values:")) != key
        },
        notes=tuple(notes),
        nodes_per_cell=arrays["cells"].shape[1],
    )
    source = dataclasses.replace(source, notes=(*notes, *loose_nodes(source)))
    return _with_sets(source, arrays, cells)


def loose_nodes(*sources: MeshSource) -> Iterator[str]:
    """Yield a sentence on nodes that belong to no element, as in a file that was cut.

    Args:
        sources: cells of each kind, with the same nodes.
    """
    used = np.unique(np.concatenate([source.cells.ravel() for source in sources]))
    if loose := len(sources[0].points) - len(used):
        yield f"{loose:,} of its nodes belong to no element: reference points, or the file is cut"


def elements_of(source: MeshSource, *, has_27: bool = False) -> Ints:
    """Return the nodes of the elements (rows of the points) in their order.

    Args:
        has_27: whether hexahedra that had 27 nodes in their file keep them; all others of degree 2 have 20.
    """
    theirs = _reference_nodes(source.kind)[: source.cells.shape[1]]
    elements = source.cells[:, np.argsort(node_order(source.kind, source.degree, theirs))]
    if elements.shape[1] != 27:
        return elements
    is_kept = has_27 and source.nodes_per_cell == 27
    return elements[:, [*range(20), 26, *range(20, 26)]] if is_kept else elements[:, :20]


def faces_of(source: MeshSource, group: Group, elements: Ints) -> Iterator[tuple[int, int]]:
    """Yield row of the element and number of the face, from 0, of each facet of a group."""
    local = np.array(FACES[vertex_count(source.kind)])
    every, place = unique_rows(np.sort(elements[:, local].reshape(-1, local.shape[1]), axis=1))
    owner = np.zeros(len(every), dtype=np.int64)
    owner[place[::-1]] = np.arange(len(place))[::-1]
    facets = np.sort(source.facets[group.members][:, : local.shape[1]], axis=1)
    table = FacetTable(every, np.zeros(0, dtype=np.int64), np.zeros((0, 0), dtype=np.int64))
    for cell, face in zip(*np.divmod(owner[table.find(facets)], len(local)), strict=True):
        yield int(cell), int(face)


def _reference_nodes(kind: str) -> Floats:
    """Reference coordinates of the nodes of an element: vertices, middles of edges and of faces, and the centre."""
    corners = _CORNERS[kind]
    edges = [corners[list(edge)].mean(axis=0) for edge in _EDGES[kind]]
    if kind == "tetrahedron":
        return np.array([*corners, *edges])
    faces = [corners[list(face)].mean(axis=0) for face in FACES[8]]
    return np.array([*corners, *edges, *faces, corners.mean(axis=0)])


def facets_of(source: MeshSource, elements: Ints) -> Ints:
    """Return the nodes of the facets of a mesh: vertices in their order, and middle nodes of their edges."""
    whole = Group("", 2, 0, np.arange(len(source.facets)))
    return _nodes_of_faces(source, elements, whole)[1]


def outward_facets(source: MeshSource, group: Group, elements: Ints) -> Ints:
    """Return the nodes of the facets of a group, whose vertices turn about the outward normal.

    Middle nodes of edges follow the vertices, and the node in the middle of elements of 27 nodes.
    """
    cells, facets = _nodes_of_faces(source, elements, group)
    size, points = len(FACES[vertex_count(source.kind)][0]), source.points
    corners = points[facets[:, :size]]
    normals = np.cross(corners[:, -2] - corners[:, 0], corners[:, -1] - corners[:, size - 3])
    inward = points[elements[cells][:, : vertex_count(source.kind)]].mean(axis=1) - corners.mean(axis=1)
    is_inward = np.einsum("fi,fi->f", normals, inward) > 0
    turned = [0, *range(size - 1, 0, -1), *range(2 * size - 1, size - 1, -1), 2 * size][: facets.shape[1]]
    facets[is_inward] = facets[is_inward][:, turned]
    return facets


def _nodes_of_faces(source: MeshSource, elements: Ints, group: Group) -> tuple[Ints, Ints]:
    """Return the cell of each facet of a group, and its nodes: vertices, middle nodes of edges, and its middle."""
    size = vertex_count(source.kind)
    local = np.array(FACES[size])
    if elements.shape[1] > size:
        local = np.column_stack([local, _middles(source.kind)])
    if elements.shape[1] == 27:  # the centre comes before the faces
        local = np.column_stack([local, np.arange(21, 27)])
    pairs = np.array(list(faces_of(source, group, elements)), dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], np.asarray(elements[pairs[:, 0, None], local[pairs[:, 1]]])


def disjoint_parts(source: MeshSource) -> tuple[Ints, list[Group], list[Group]]:
    """Return the part of each cell, which is a place in the list of groups that follows (-1: none), and other groups.

    Formats in which a cell is in one block have other means for groups that overlap.
    """
    part = np.full(len(source.cells), -1, dtype=np.int64)
    blocks, others = list[Group](), list[Group]()
    for group in source.groups:
        if group.dim != 3:
            continue
        if (part[group.members] >= 0).any():
            others.append(group)
        else:
            part[group.members] = len(blocks)
            blocks.append(group)
    return part, blocks, others


def node_sets(source: MeshSource, elements: Ints) -> Iterator[tuple[str, Ints]]:
    """Yield the name and the nodes of each group of facets, for formats without surfaces."""
    used = np.unique(elements)
    for group in source.groups:
        if group.dim == 2:
            yield group.name, np.intersect1d(source.facets[group.members], used)


def check_names(source: MeshSource, pattern: str, advice: str) -> None:
    """Raise ``MeshError`` for a group whose name a format cannot store."""
    for group in source.groups:
        if not re.fullmatch(pattern, group.name):
            raise MeshError(f"the name '{group.name}' is not possible in this format", advice)


def check_numbers(source: MeshSource, most: int = 2**31 - 1) -> None:
    """Raise ``MeshError`` for numbers of nodes and cells, and of facets after them, beyond what a format can store."""
    if max(source.node_tags.max(), source.cell_tags.max() + len(source.facets)) > most:
        raise MeshError(f"numbers beyond {most:,} are not possible in this format", "Number the mesh again.")


def _middles(kind: str) -> Ints:
    """Return places of the middle nodes of the edges of each face."""
    edges = [frozenset(edge) for edge in _EDGES[kind]]
    faces = FACES[len(_CORNERS[kind])]
    sides = [[frozenset((face[i - 1], face[i])) for i in (*range(1, len(face)), 0)] for face in faces]
    return np.array([[len(_CORNERS[kind]) + edges.index(side) for side in sides_of] for sides_of in sides])


def _completed(cells: Ints, points: Floats, tags: Ints) -> tuple[Ints, Floats, Ints]:
    """Return hexahedra of 20 nodes with nodes in the middle of faces and cells, where 20 nodes have these points."""
    faces, middles = np.array(FACES[8]), _middles("hexahedron")
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


def _surface_nodes(
    name: str, arrays: Mapping[str, npt.NDArray[Any]], elements: Ints, local: Ints
) -> npt.NDArray[Any] | None:
    """Return the vertices of the surface of a name; ``None`` if there is none."""
    faces = arrays.get(f"faces:{name}")
    parts = [] if faces is None else [elements[faces[:, 0, None], local[faces[:, 1]]].ravel()]
    parts += [arrays[key].ravel() for key in (f"facets:{name}", f"skin:{name}") if key in arrays]
    return np.unique(np.concatenate(parts)) if parts else None


def _with_sets(source: MeshSource, arrays: Mapping[str, npt.NDArray[Any]], elements: Ints) -> MeshSource:
    """Return the mesh with a group for each set and surface; ``elements`` have the order of the file."""
    sets = _Sets(source, arrays, elements)
    for key, rows in arrays.items():
        place, separator, name = key.partition(":")
        if not separator or place == "values":
            continue
        if place == "cells":
            sets.groups.append(Group(name, 3, 0, rows))
        elif place == "nodes":
            sets.add_nodes(name, rows)
        else:
            sets.add_surface(place, name, rows)
    source = dataclasses.replace(source, groups=distinct_tags(sets.groups), thin_groups=tuple(sets.thin))
    return add_facets(source, sets.sides)


class _Sets:
    """Groups of cells and facets that sets and surfaces are.

    Attributes:
        groups: of cells.
        sides: cell and number of each facet, by the name of the group of facets.
        thin: names of node sets that have neither all vertices of a facet nor of a cell.
    """

    def __init__(self, source: MeshSource, arrays: Mapping[str, npt.NDArray[Any]], elements: Ints) -> None:
        self.groups, self.sides, self.thin = list[Group](), dict[str, Ints](), list[str]()
        self._source, self._arrays, self._elements = source, arrays, elements
        self._vertices = source.cells[:, : vertex_count(source.kind)]
        self._table = FacetTable.build(source.kind, self._vertices)
        self._local = np.array(FACES[self._vertices.shape[1]])

    def add_surface(self, place: str, name: str, rows: Ints) -> None:
        """Add a surface by its faces, facets, or surface elements (``skin``), which may be elsewhere."""
        is_of_faces = place == "faces"
        facets = self._table.find(self._elements[rows[:, 0, None], self._local[rows[:, 1]]] if is_of_faces else rows)
        if place == "skin":
            facets = facets[facets >= 0]
        if (facets < 0).any():
            text = f"{(facets < 0).sum():,} of {len(facets):,} facets of surface '{name}' belong to no solid element"
            raise MeshError(f"{self._source.path}: {text}", "Save the surface of the solid elements.")
        self._add_facets(name, facets)

    def add_nodes(self, name: str, rows: Ints) -> None:
        """Add a node set, unless a surface of its name has the same nodes, which is exact."""
        surface = _surface_nodes(name, self._arrays, self._elements, self._local)
        if surface is not None:
            of_set, of_surface = (np.intersect1d(nodes, self._vertices) for nodes in (rows, surface))
            if np.array_equal(of_set, of_surface):
                return
            name = f"{name}{OF_NODES}"
        is_inside = np.zeros(len(self._source.points), dtype=bool)
        is_inside[rows] = True
        facets, cells = facets_and_cells_inside(self._table, self._vertices, is_inside)
        if len(cells) and name not in {group.name for group in self.groups}:
            self.groups.append(Group(name, 3, 0, cells))
        if not len(cells) and not len(facets):
            self.thin.append(name)
        self._add_facets(name, facets)

    def _add_facets(self, name: str, facets: Ints) -> None:
        if len(facets):
            earlier = self.sides.get(name, np.zeros((0, 2), dtype=np.int64))
            self.sides[name] = np.unique(np.concatenate([earlier, self._table.owners(facets)]), axis=0)
