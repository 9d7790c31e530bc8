"""Faces of solid elements in the order of Abaqus, and faces whose middle nodes bear the forces of a uniform load."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

FACES = {
    4: ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    8: ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
}
"""vertices of the faces S1, S2, … of an element, by its number of vertices"""
_MIDDLES = {
    10: {(0, 1): 4, (1, 2): 5, (0, 2): 6, (0, 3): 7, (1, 3): 8, (2, 3): 9},
    20: {
        (0, 1): 8,
        (1, 2): 9,
        (2, 3): 10,
        (0, 3): 11,
        (4, 5): 12,
        (5, 6): 13,
        (6, 7): 14,
        (4, 7): 15,
        (0, 4): 16,
        (1, 5): 17,
        (2, 6): 18,
        (3, 7): 19,
    },
}
"""middle node of an edge by its vertices, by number of nodes of an element"""
_SQUARE = {10: 4, 20: 8}


def with_vertices(loaded: Mapping[str, frozenset[int]], elements: Iterable[Sequence[int]]) -> dict[str, frozenset[int]]:
    """Return sets of loaded nodes with the vertices of the faces all of whose middle nodes they have.

    The load of a uniform traction has no force on the vertices of C3D10, and opposite ones on the vertices of C3D20. A
    set that has vertices of another set's faces only is left out: its forces belong to that traction.
    """
    result, every = {}, list(elements)
    for name, nodes in loaded.items():
        vertices: set[int] = set()
        for element in every:
            if len(element) in _MIDDLES and len(nodes.intersection(element)) > 2:
                vertices.update(_vertices_of_faces(element, nodes))
        result[name] = nodes | vertices
    merged = {a for a in loaded for b in loaded if a != b and loaded[a] <= result[b] - loaded[b]}
    return {name: nodes for name, nodes in result.items() if name not in merged}


def _vertices_of_faces(element: Sequence[int], nodes: frozenset[int]) -> Iterator[int]:
    """Yield the vertices of the faces of an element all of whose middle nodes are in a set."""
    middles = _MIDDLES[len(element)]
    for face in FACES[_SQUARE[len(element)]]:
        edges = ((min(pair), max(pair)) for pair in ((face[i - 1], face[i]) for i in range(len(face))))
        if all(element[middles[edge]] in nodes for edge in edges):
            yield from (element[corner] for corner in face)
