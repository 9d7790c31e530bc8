"""Input files of Abaqus and CalculiX: node sets, element sets and surfaces are regions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.mesh_format import Groups, Later, MeshFormat
from hpcinv.errors import MeshError
from hpcinv.formats.readers.followed_includes import followed, included_files

if TYPE_CHECKING:
    import numpy as np

    from hpcinv.mesh.source import Floats, Ints, MeshSource
else:
    np = Later("numpy")


_CONDITIONS = (
    r".+-(P[1-6]|EDNOR[1-4]|nodes|surface)",
    r"held-[rxyz]+(=.+)?",
    r"(loaded|turned|pressed|edge-loaded)(-\d+)?",
)
"""faces of the elements of a set, by a line of ``*DLOAD``, and what lines on single nodes and elements hold or load"""


class Inp(MeshFormat):
    suffix = ".inp"
    action = "inp"
    elements = "an input file"
    saver = "hpcinv.formats.inp:save_inp"
    saves_27_nodes = "if read"

    def groups(self, path: Path) -> Groups | None:
        """Groups by the names of sets and surfaces; unknown in an assembly, whose sets belong to instances."""
        try:
            names = followed("inp-names", path)["names"]
        except Fault:  # reported by the reader
            return None
        return None if names is None else Groups(frozenset(names), patterns=_CONDITIONS)

    def data_files(self, path: Path, *, isolated: bool | None = None) -> list[str]:
        """Files that it includes."""
        return included_files("inp-files", path, isolated=isolated)


_NAMES = {
    ("tetrahedron", 1): "C3D4",
    ("tetrahedron", 2): "C3D10",
    ("hexahedron", 1): "C3D8",
    ("hexahedron", 2): "C3D20",
}
_COMPLETE = "C3D27"
_SHELLS = {("triangle", 1): "S3", ("triangle", 2): "S6", ("quadrilateral", 1): "S4", ("quadrilateral", 2): "S8R"}
_FIELD = 20
_PER_LINE = 16
"""numbers in a line of a set, the most that Abaqus reads"""


def number(value: float) -> str:
    """Return a number in at most 20 characters, the field that CalculiX reads: all digits, or the first 14."""
    text = repr(value)
    return text if len(text) <= _FIELD else f"{value:.13e}"


def save_inp(path: Path, source: MeshSource, points: Floats) -> None:
    """Write nodes, elements, sets and surfaces at ``points`` (n, 3); hexahedra of degree 2 as C3D20 (C3D27 if read so).

    A region of facets is a surface, and a node set of the same name. The surface of a shell has the elements of its
    file with their numbers (quadrilaterals of degree 2 as S8R), sets of elements, node sets of edges, and the
    thickness at its nodes.

    Raises:
        OSError: it cannot be written.
    """
    from hpcinv.formats.readers.elements import elements_of, faces_of

    if source.kind in ("triangle", "quadrilateral"):
        _save_surface(path, source, points)
        return
    elements = elements_of(source, has_27=True)
    _check_names(source)
    tags, used = source.node_tags, np.unique(elements)
    with path.open("w", encoding="utf-8") as file:
        file.write("*HEADING\nWritten by hpcinv\n*NODE\n")
        file.writelines(
            f"{tag}, {', '.join(map(number, point))}\n"
            for tag, point in zip(tags[used].tolist(), points[used].tolist(), strict=True)
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


def _check_names(source: MeshSource) -> None:
    if bad := [group.name for group in source.groups if set(group.name) & set(',"\n') or not group.name.strip()]:
        raise MeshError(f"the name '{bad[0]}' is not possible in this format", "Rename the region.")


def _save_surface(path: Path, source: MeshSource, points: Floats) -> None:
    """Write the surface of a shell."""
    parts = source.read_as or (source,)
    tags = parts[0].node_tags  # of the first nodes of the surface
    _check_names(parts[0])
    cells = [_nodes_of_shells(part) for part in parts]
    used = np.unique(np.concatenate([nodes.ravel() for nodes in cells]))
    with path.open("w", encoding="utf-8") as file:
        file.write("*HEADING\nWritten by hpcinv\n*NODE\n")
        rows = zip(tags[used].tolist(), points[used].tolist(), strict=True)
        file.writelines(f"{tag}, {', '.join(map(number, point))}\n" for tag, point in rows)
        elements = list[tuple[int, str, list[int]]]()
        for part, nodes in zip(parts, cells, strict=True):
            kinds = [_SHELLS[part.kind, part.degree]] * len(nodes)
            elements += zip(part.cell_tags.tolist(), kinds, tags[nodes].tolist(), strict=True)
        elements.sort()
        for kind, rows_of_kind in groupby(elements, lambda element: element[1]):
            file.write(f"*ELEMENT, TYPE={kind}\n")
            for tag, _, own in rows_of_kind:
                file.writelines(_lines([tag, *own]))
        file.writelines(_sets_of_surface(parts, used))
        if (thickness := source.data.get("thickness")) is not None:
            file.write("*NODAL THICKNESS\n")
            values = thickness.values[used, 0] / (source.unit or 1.0)
            file.writelines(
                f"{tag}, {number(t)}\n" for tag, t in zip(tags[used].tolist(), values.tolist(), strict=True)
            )


def _nodes_of_shells(part: MeshSource) -> Ints:
    """Return the nodes of the elements of a surface, without centres of quadrilaterals."""
    from hpcinv.mesh.cells import vtk_order

    nodes = part.cells[:, np.argsort(vtk_order(part.kind, part.degree))]
    return nodes[:, :8] if nodes.shape[1] == 9 else nodes


def _sets_of_surface(parts: Sequence[MeshSource], used: Ints) -> Iterator[str]:
    """Yield the lines of the sets of a shell: of elements, and of the nodes of edges, which all parts have."""
    for name, dim in dict.fromkeys((group.name, group.dim) for part in parts for group in part.groups):
        groups = [(part, group) for part in parts for group in part.groups if (group.name, group.dim) == (name, dim)]
        if dim == 3:
            yield f"*ELSET, ELSET={name}\n"
            yield from _rows(np.concatenate([part.cell_tags[group.members] for part, group in groups]).tolist())
        else:
            part, group = groups[0]
            yield f"*NSET, NSET={name}\n"
            yield from _rows(part.node_tags[np.intersect1d(part.facets[group.members], used)].tolist())


def _rows(numbers: list[int]) -> Iterator[str]:
    """Yield lines of a set."""
    for start in range(0, len(numbers), _PER_LINE):
        yield f"{', '.join(map(str, numbers[start : start + _PER_LINE]))}\n"


def _lines(numbers: list[int]) -> Iterator[str]:
    """Yield lines of an element; all but the last end with a comma."""
    for start in range(0, len(numbers), _PER_LINE):
        part = ", ".join(map(str, numbers[start : start + _PER_LINE]))
        yield f"{part},\n" if start + _PER_LINE < len(numbers) else f"{part}\n"
