"""Meshes of Medit, read and written as text."""

import re
from pathlib import Path

import numpy as np

from hpcinv.errors import MeshError
from hpcinv.formats.readers.elements import elements_of, facets_of
from hpcinv.mesh.cells import FACET_KIND
from hpcinv.mesh.source import Floats, Group, Ints, MeshSource

_SECTIONS = {"triangle": "Triangles", "quadrilateral": "Quadrilaterals"}
_CELLS = {"tetrahedron": "Tetrahedra", "hexahedron": "Hexahedra"}
_NUMBER = re.compile(r"(?:volume|surface)-(\d{1,9})")


def save_medit(path: Path, source: MeshSource, points: Floats) -> None:
    """Write vertices, cells and facets at ``points`` (n, 3); regions keep their numbers, not their names.

    Raises:
        MeshError: cells are curved, or regions overlap.
        OSError: it cannot be written.
    """
    if source.degree > 1:
        raise MeshError("curved cells are not possible in this format", "Write the mesh in another format.")
    elements = elements_of(source)
    facets = facets_of(source, elements)
    cell_numbers, facet_numbers = _references(source, 3), _references(source, 2)
    with path.open("w", encoding="latin-1") as file:
        file.write(f"MeshVersionFormatted 2\nDimension 3\nVertices\n{len(points)}\n")
        file.writelines(f"{x!r} {y!r} {z!r} 0\n" for x, y, z in points.tolist())
        for name, rows, numbers in (
            (_CELLS[source.kind], elements, cell_numbers),
            (_SECTIONS[FACET_KIND[source.kind]], facets, facet_numbers),
        ):
            file.write(f"{name}\n{len(rows)}\n")
            table = np.column_stack([rows + 1, numbers]).tolist()
            file.writelines(f"{' '.join(map(str, row))}\n" for row in table)
        file.write("End\n")


def _references(source: MeshSource, dim: int) -> Ints:
    """Return the reference of each cell or facet: the number in the name of its group, or its tag."""
    if source.groups_overlap(dim):
        raise MeshError("overlapping regions are not possible in this format", "Write the mesh in another format.")
    groups = [group for group in source.groups if group.dim == dim]
    numbers = np.zeros(len(source.cells if dim == 3 else source.facets), dtype=np.int64)
    given = [_number(group) for group in groups]
    for place, group in enumerate(groups):
        numbers[group.members] = given[place] if len(set(given)) == len(given) else place + 1
    return numbers


def _number(group: Group) -> int:
    return int(match[1]) if (match := _NUMBER.fullmatch(group.name)) else group.tag
