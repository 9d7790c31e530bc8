"""Input files of Abaqus and CalculiX, read and written."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hpcinv.errors import MeshError
from hpcinv.mesh.io.elements import elements_of, faces_of, read_elements
from hpcinv.mesh.source import Floats, MeshSource

_NAMES = {
    ("tetrahedron", 1): "C3D4",
    ("tetrahedron", 2): "C3D10",
    ("hexahedron", 1): "C3D8",
    ("hexahedron", 2): "C3D20",
}
_COMPLETE = "C3D27"
_PER_LINE = 16
"""numbers in a line of a set, the most that Abaqus reads"""


def read_inp(path: Path) -> MeshSource:
    """Read nodes, solid elements, sets and surfaces; materials, loads and steps are not used.

    Raises:
        MeshError: the file cannot be read, or is not a mesh.
    """
    return read_elements(path, "inp", "cannot be read as an input file")


def save_inp(path: Path, source: MeshSource, points: Floats) -> None:
    """Write nodes, elements, sets and surfaces at ``points`` (n, 3); hexahedra of degree 2 as C3D20 (C3D27 if read so).

    A region of facets is a surface, and a node set of the same name.

    Raises:
        OSError: it cannot be written.
    """
    elements = elements_of(source, has_27=True)
    if bad := [group.name for group in source.groups if set(group.name) & set(',"\n') or not group.name.strip()]:
        raise MeshError(f"the name '{bad[0]}' is not possible in this format", "Rename the region.")
    tags, used = source.node_tags, np.unique(elements)
    with path.open("w", encoding="utf-8") as file:
        file.write("*HEADING\nWritten by hpcinv\n*NODE\n")
        file.writelines(
            f"{tag}, {x!r}, {y!r}, {z!r}\n"
            for tag, (x, y, z) in zip(tags[used].tolist(), points[used].tolist(), strict=True)
        )
        name = _COMPLETE if elements.shape[1] == 27 else _NAMES[source.kind, source.degree]
        file.write(f"*ELEMENT, TYPE={name}\n")
        for tag, nodes in zip(source.cell_tags.tolist(), tags[elements].tolist(), strict=True):
            file.writelines(_lines([tag, *nodes]))
        for group in source.groups:
            if group.dim == 3:
                file.write(f"*ELSET, ELSET={group.name}\n")
                file.writelines(_rows(source.cell_tags[group.members].tolist()))
            else:
                file.write(f"*SURFACE, NAME={group.name}, TYPE=ELEMENT\n")
                faces = faces_of(source, group, elements)
                file.writelines(f"{source.cell_tags[cell]}, S{face + 1}\n" for cell, face in faces)
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
