"""Model files of FEBio: parts, node sets, element sets and surfaces are regions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.later import Later
from hpcinv.base.reading.mesh_format import OF_NODES, Groups, MeshFormat

if TYPE_CHECKING:
    import numpy as np

    from hpcinv.mesh.source import Floats, Group, Ints, MeshSource
else:
    np = Later("numpy")


_UNNAMED = r"part-\d+"
_LARGEST = 200 * 2**20
"""bytes of a file that is searched for names; raised, ``validate`` may take seconds"""


class Feb(MeshFormat):
    suffix = ".feb"
    action = "feb"
    elements = "a model of FEBio"
    saver = "hpcinv.formats.feb:save_feb"
    saves_27_nodes = "never"

    def groups(self, path: Path) -> Groups | None:
        """Groups by the names of parts, sets and surfaces; parts without a name are called such as ``part-2``."""
        from hpcinv.base.reading.feb_model import names_in  # loads a parser of XML

        if path.stat().st_size > _LARGEST:
            return None
        try:
            return Groups(frozenset(names_in(path)), patterns=(_UNNAMED, f".+{OF_NODES}"))
        except Fault:  # reported by the reader
            return None


_NAMES = {
    ("tetrahedron", 1): "tet4",
    ("tetrahedron", 2): "tet10",
    ("hexahedron", 1): "hex8",
    ("hexahedron", 2): "hex20",
}


def save_feb(path: Path, source: MeshSource, points: Floats) -> None:
    """Write the mesh at ``points`` (n, 3) as a model without materials; hexahedra of degree 2 as hex20.

    Surfaces have the vertices of their facets, and a node set of the same name.

    Raises:
        OSError: it cannot be written.
    """
    from hpcinv.formats.readers.elements import elements_of

    elements = elements_of(source)
    whole = [group.name for group in source.groups if group.dim == 3 and len(group.members) == len(source.cells)]
    parts = {whole[0] if whole else "all elements": np.arange(len(source.cells))}  # format 4 needs a name
    lines = [*HEAD, '<Module type="solid"/>', *mesh_lines(source, points, elements, parts), "</febio_spec>"]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


HEAD = '<?xml version="1.0" encoding="UTF-8"?>', '<febio_spec version="4.0">'
"""first lines of a model"""


def mesh_lines(source: MeshSource, points: Floats, elements: Ints, parts: Mapping[str, Ints]) -> Iterator[str]:
    """Yield the section of a mesh at ``points`` (n, 3), with sets and surfaces for its groups.

    Args:
        elements: nodes of the elements (rows of the points) in the order of FEBio.
        parts: rows of the elements of each part, by its name.
    """
    tags, used = source.node_tags, np.unique(elements)
    yield "<Mesh>"
    yield "<Nodes>"
    for tag, (x, y, z) in zip(tags[used].tolist(), points[used].tolist(), strict=True):
        yield f'<node id="{tag}">{x!r},{y!r},{z!r}</node>'
    yield "</Nodes>"
    for name, rows in parts.items():
        yield f'<Elements type="{_NAMES[source.kind, source.degree]}" name="{escape(name)}">'
        for tag, nodes in zip(source.cell_tags[rows].tolist(), tags[elements[rows]].tolist(), strict=True):
            yield f'<elem id="{tag}">{",".join(map(str, nodes))}</elem>'
        yield "</Elements>"
    for group in source.groups:
        if group.dim == 3:
            yield f'<ElementSet name="{escape(group.name)}">{_listed(source.cell_tags[group.members])}</ElementSet>'
        else:
            yield from _surface(source, group, elements, used)
    yield "</Mesh>"


def _surface(source: MeshSource, group: Group, elements: Ints, used: Ints) -> Iterator[str]:
    from hpcinv.base.reading.element_faces import FACES
    from hpcinv.formats.readers.elements import faces_of
    from hpcinv.mesh.cells import vertex_count

    local = FACES[vertex_count(source.kind)]
    kind = "tri3" if len(local[0]) == 3 else "quad4"
    yield f'<Surface name="{escape(group.name)}">'
    for number, (cell, face) in enumerate(faces_of(source, group, elements), 1):
        yield f'<{kind} id="{number}">{_listed(source.node_tags[elements[cell, list(local[face])]])}</{kind}>'
    yield "</Surface>"
    nodes = np.intersect1d(source.facets[group.members], used)
    yield f'<NodeSet name="{escape(group.name)}">{_listed(source.node_tags[nodes])}</NodeSet>'


def _listed(numbers: Ints) -> str:
    return ",".join(map(str, numbers.tolist()))
