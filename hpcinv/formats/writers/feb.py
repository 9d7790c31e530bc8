"""Meshes in model files of FEBio, read (formats 2.5 to 4.0) and written (4.0)."""

from collections.abc import Iterator
from html import escape
from pathlib import Path

import numpy as np

from hpcinv.base.reading.inp_files import FACES
from hpcinv.formats.readers.elements import elements_of, faces_of
from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.source import Floats, Group, Ints, MeshSource

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
    elements = elements_of(source)
    path.write_text("\n".join(_lines(source, points, elements)) + "\n", encoding="utf-8")


def _lines(source: MeshSource, points: Floats, elements: Ints) -> Iterator[str]:
    tags, used = source.node_tags, np.unique(elements)
    yield '<?xml version="1.0" encoding="UTF-8"?>'
    yield '<febio_spec version="4.0">'
    yield '<Module type="solid"/>'
    yield "<Mesh>"
    yield "<Nodes>"
    for tag, (x, y, z) in zip(tags[used].tolist(), points[used].tolist(), strict=True):
        yield f'<node id="{tag}">{x!r},{y!r},{z!r}</node>'
    yield "</Nodes>"
    whole = [group.name for group in source.groups if group.dim == 3 and len(group.members) == len(source.cells)]
    name = escape(whole[0] if whole else "all elements")  # format 4 needs one
    yield f'<Elements type="{_NAMES[source.kind, source.degree]}" name="{name}">'
    for tag, nodes in zip(source.cell_tags.tolist(), tags[elements].tolist(), strict=True):
        yield f'<elem id="{tag}">{",".join(map(str, nodes))}</elem>'
    yield "</Elements>"
    for group in source.groups:
        if group.dim == 3:
            yield f'<ElementSet name="{escape(group.name)}">{_listed(source.cell_tags[group.members])}</ElementSet>'
        else:
            yield from _surface(source, group, elements, used)
    yield "</Mesh>"
    yield "</febio_spec>"


def _surface(source: MeshSource, group: Group, elements: Ints, used: Ints) -> Iterator[str]:
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
