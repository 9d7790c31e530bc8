"""Meshes of Medit (``.mesh``, as text): vertices, straight cells, and facets, with references as regions."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.fault import Fault, shown
from hpcinv.base.reading.included_files import text_of
from hpcinv.base.reading.mesh_format import Later, MeshFormat
from hpcinv.base.reading.numbered_elements import Blocks, element_arrays
from hpcinv.errors import MeshError

if TYPE_CHECKING:
    import numpy as np

    from hpcinv.mesh.source import Floats, Group, Ints, MeshSource
else:
    np = Later("numpy")


class Medit(MeshFormat):
    suffix = ".mesh"
    action = "medit"
    elements = "a file of Medit"
    saver = "hpcinv.formats.medit:save_medit"


_SECTIONS = {
    "vertices": 4,
    "edges": 3,
    "triangles": 4,
    "quadrilaterals": 5,
    "tetrahedra": 5,
    "hexahedra": 9,
    "corners": 1,
    "requiredvertices": 1,
    "ridges": 1,
    "requirededges": 1,
    "requiredtriangles": 1,
    "normals": 3,
    "tangents": 3,
    "normalatvertices": 2,
    "tangentatvertices": 2,
}
"""numbers of an entry, by the name of a section"""
_KINDS = "Tetrahedra and Hexahedra"


def read_medit(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return arrays of vertices, cells and references; a reference of 0 makes no region."""
    content = admitted(path).read_bytes()
    if content[:4] in (b"\1\0\0\0", b"\0\0\0\1"):
        raise Fault("is a binary file of Medit", "Save it as text (.mesh).")
    words = [word for line in text_of(path).splitlines() for word in line.split("#")[0].split()]
    sections = _sections(words)
    if "vertices" not in sections:
        raise Fault("has no section Vertices", "Is it a file of Medit?")
    vertices = sections["vertices"]
    blocks, sets = _elements(sections)
    tags = np.arange(1, len(vertices) + 1)
    return {"ignored": []}, element_arrays(tags, vertices[:, :3], blocks, sets, _KINDS)


def _sections(words: list[str]) -> dict[str, Any]:
    """Return the tables of a file, by the names of their sections; sections of one name are joined.

    Raises:
        Fault: the file is cut, or has what is not read.
    """
    sections: dict[str, Any] = {}
    at = 0
    while at < len(words):
        name = words[at].lower()
        at += 1
        if name == "end":
            return sections
        if name in ("meshversionformatted", "dimension"):
            if name == "dimension" and words[at : at + 1] != ["3"]:
                raise Fault("is not a mesh in three dimensions")
            at += 1
        elif name in _SECTIONS:
            count = _count(words[at] if at < len(words) else "", name)
            end = at + 1 + count * _SECTIONS[name]
            if end > len(words):
                raise Fault(f"section {name} has fewer than {count:,} entries", "Is the file complete?")
            table = _table(words[at + 1 : end], name)
            sections[name] = np.concatenate([sections[name], table]) if name in sections else table
            at = end
        else:
            _refuse(name, words[at - 1])
    if sections:
        raise Fault("has no End", "Is the file complete?")
    return sections


def _refuse(name: str, word: str) -> None:
    """Raise ``Fault`` for a section that counts and is not read, or for what is not the name of a section."""
    if name.startswith(("tetrahedrap", "hexahedraq", "trianglesp", "quadrilateralsq")):
        raise Fault("has curved cells", "Save a mesh of straight cells, or use another format.")
    if name.startswith(("prisms", "pyramids")):
        raise Fault(f"has {name}", f"Cells are {_KINDS}.")
    if not name[0].isalpha():
        raise Fault(f"'{shown(word)}' is not the name of a section", "Is the file complete?")


def _elements(sections: dict[str, Any]) -> tuple[Blocks, dict[str, list[int]]]:
    """Return cells and facets, and the cells of each reference."""
    blocks, sets = Blocks(), dict[str, list[int]]()
    first = 1
    for name in ("tetrahedra", "hexahedra"):
        for tag, (*nodes, reference) in enumerate(_whole(sections, name), first):
            blocks.add(tag, nodes)
            if reference:
                sets.setdefault(f"cells:volume-{reference}", []).append(tag)
        first += len(sections.get(name, ()))
    for name in ("triangles", "quadrilaterals"):
        for tag, (*nodes, reference) in enumerate(_whole(sections, name), first):
            blocks.add_facet(tag, nodes, f"surface-{reference}" if reference else "")
        first += len(sections.get(name, ()))
    return blocks, sets


def _count(word: str, name: str) -> int:
    if not word.isdecimal() or len(word) > 12:
        raise Fault(f"section {name} does not say how many entries it has", "Is the file complete?")
    return int(word)


def _table(words: list[str], name: str) -> Any:
    try:
        return np.array(words, dtype=np.float64).reshape(-1, _SECTIONS[name])
    except ValueError:
        raise Fault(f"section {name} has entries that are not numbers", "Is the file complete?") from None


def _whole(sections: dict[str, Any], name: str) -> list[list[int]]:
    table = sections.get(name, np.zeros((0, 1)))
    if table.size and not (np.isfinite(table).all() and (np.rint(table) == table).all() and table.max() < 2**53):
        raise Fault(f"section {name} has entries that are not whole numbers", "Is the file complete?")
    rows: list[list[int]] = np.asarray(table, dtype=np.int64).tolist()
    return rows


_FLAT_SECTIONS = {"triangle": "Triangles", "quadrilateral": "Quadrilaterals"}
_CELLS = {"tetrahedron": "Tetrahedra", "hexahedron": "Hexahedra"}
_NUMBER = re.compile(r"(?:volume|surface)-(\d{1,9})")


def save_medit(path: Path, source: MeshSource, points: Floats) -> None:
    """Write vertices, cells and facets at ``points`` (n, 3); regions keep their numbers, not their names.

    Raises:
        MeshError: cells are curved, or regions overlap.
        OSError: it cannot be written.
    """
    from hpcinv.formats.readers.elements import elements_of, facets_of
    from hpcinv.mesh.cells import FACET_KIND

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
            (_FLAT_SECTIONS[FACET_KIND[source.kind]], facets, facet_numbers),
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
