"""Model files of FEBio: parts, node sets, element sets and surfaces are regions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.mesh_format import OF_NODES, Groups, Later, MeshFormat

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
    saves_27_nodes = "if read"

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
_COMPLETE = [*range(20), 23, 24, 25, 26, 21, 22, 20]
"""places of the nodes of hex27 in the order of C3D27"""
_FACETS = {3: "tri3", 6: "tri6", 4: "quad4", 8: "quad8", 9: "quad9"}


def save_feb(path: Path, source: MeshSource, points: Floats) -> None:
    """Write the mesh at ``points`` (n, 3) as a model without materials.

    Hexahedra of degree 2 are hex20, or hex27 if they were read so. Surfaces have all nodes of their facets, turned
    outward, and a node set of the same name.

    Raises:
        OSError: it cannot be written.
    """
    from hpcinv.formats.readers.elements import elements_of

    elements = elements_of(source, has_27=True)
    whole = [group.name for group in source.groups if group.dim == 3 and len(group.members) == len(source.cells)]
    parts = {whole[0] if whole else "all elements": np.arange(len(source.cells))}  # format 4 needs a name
    lines = [*HEAD, '<Module type="solid"/>', *mesh_lines(source, points, elements, parts), "</febio_spec>"]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


HEAD = '<?xml version="1.0" encoding="UTF-8"?>', '<febio_spec version="4.0">'
"""first lines of a model"""


def in_febio_order(elements: Ints) -> Ints:
    """Return the nodes of elements in the order of FEBio instead of the order of Abaqus."""
    return elements[:, _COMPLETE] if elements.shape[1] == 27 else elements


def mesh_lines(source: MeshSource, points: Floats, elements: Ints, parts: Mapping[str, Ints]) -> Iterator[str]:
    """Yield the section of a mesh at ``points`` (n, 3), with sets and surfaces for its groups.

    Args:
        elements: nodes of the elements (rows of the points) in the order of Abaqus.
        parts: rows of the elements of each part, by its name.
    """
    tags, used = source.node_tags, np.unique(elements)
    yield "<Mesh>"
    yield "<Nodes>"
    for tag, (x, y, z) in zip(tags[used].tolist(), points[used].tolist(), strict=True):
        yield f'<node id="{tag}">{x!r},{y!r},{z!r}</node>'
    yield "</Nodes>"
    kind = "hex27" if elements.shape[1] == 27 else _NAMES[source.kind, source.degree]
    listed = in_febio_order(elements)
    for name, rows in parts.items():
        yield f'<Elements type="{kind}" name="{escape(name)}">'
        for tag, nodes in zip(source.cell_tags[rows].tolist(), tags[listed[rows]].tolist(), strict=True):
            yield f'<elem id="{tag}">{",".join(map(str, nodes))}</elem>'
        yield "</Elements>"
    for group in source.groups:
        if group.dim == 3:
            yield f'<ElementSet name="{escape(group.name)}">{_listed(source.cell_tags[group.members])}</ElementSet>'
        else:
            yield from _surface(source, group, elements, used)
    yield "</Mesh>"


def _surface(source: MeshSource, group: Group, elements: Ints, used: Ints) -> Iterator[str]:
    from hpcinv.formats.readers.elements import outward_facets

    facets = outward_facets(source, group, elements)
    kind = _FACETS[facets.shape[1]]
    yield f'<Surface name="{escape(group.name)}">'
    for number, nodes in enumerate(source.node_tags[facets], 1):
        yield f'<{kind} id="{number}">{_listed(nodes)}</{kind}>'
    yield "</Surface>"
    nodes = np.intersect1d(source.facets[group.members], used)
    yield f'<NodeSet name="{escape(group.name)}">{_listed(source.node_tags[nodes])}</NodeSet>'


def _listed(numbers: Ints) -> str:
    return ",".join(map(str, numbers.tolist()))
