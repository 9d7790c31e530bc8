"""Archives of Ansys (``.cdb``, by ``CDWRITE``): nodes, elements and components.

Source: *Ansys Mechanical APDL Command Reference*, NBLOCK, EBLOCK, CMBLOCK and ETBLOCK; *Element Reference*, SOLID185,
SOLID186, SOLID187 and SOLID285.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from hpcinv.base.reading.mesh_format import Later, MeshFormat

if TYPE_CHECKING:
    import numpy as np

    from hpcinv.mesh.source import Floats, Ints, MeshSource
else:
    np = Later("numpy")


class Cdb(MeshFormat):
    suffix = ".cdb"
    action = "cdb"
    elements = "an archive of Ansys"
    saver = "hpcinv.formats.cdb:save_cdb"
    saves_27_nodes = "never"


_NUMBERS = {("tetrahedron", 1): 285, ("tetrahedron", 2): 187, ("hexahedron", 1): 185, ("hexahedron", 2): 186}
_NAME = r"[A-Za-z]\w{0,31}"
_PER_LINE = 8
"""numbers in a line of a component, as Ansys writes them"""


def save_cdb(path: Path, source: MeshSource, points: Floats) -> None:
    """Write nodes, elements and components at ``points`` (n, 3); a region of facets is a component of nodes.

    Coordinates have 17 digits, more than Ansys writes.

    Raises:
        OSError: it cannot be written.
    """
    from hpcinv.formats.readers.elements import check_names, elements_of

    check_names(source, _NAME, "Components have up to 32 letters, digits and underscores; rename the region.")
    elements = elements_of(source)
    materials = np.ones(len(elements), dtype=np.int64)
    with path.open("w", encoding="latin-1") as file:
        file.write(f"/PREP7\nET,        1,{_NUMBERS[source.kind, source.degree]}\n")
        file.writelines(mesh_lines(source, points, elements, source.node_tags[elements], materials))
        file.write("FINISH\n")


def mesh_lines(source: MeshSource, points: Floats, elements: Ints, numbers: Ints, materials: Ints) -> Iterator[str]:
    """Yield nodes at ``points`` (n, 3), elements of type 1, and components.

    Args:
        elements: nodes (rows of the points) of the elements (m, k).
        numbers: of the nodes of each element, (m, l), as its type lists them.
        materials: number of the material of each element, (m,).
    """
    from hpcinv.formats.readers.elements import node_sets

    tags, used = source.node_tags, np.unique(elements)
    yield f"NBLOCK,6,SOLID,{tags[used].max():10d},{len(used):10d}\n(3i10,6e25.16e3)\n"
    for tag, position in zip(tags[used].tolist(), points[used].tolist(), strict=True):
        yield f"{tag:10d}{0:10d}{0:10d}{''.join(map(_real, position))}\n"
    yield f"N,R5.3,LOC,       -1,\nEBLOCK,19,SOLID,{source.cell_tags.max():10d},{len(elements):10d}\n(19i10)\n"
    for tag, material, nodes in zip(source.cell_tags.tolist(), materials.tolist(), numbers.tolist(), strict=True):
        entries = [material, 1, 1, 1, 0, 0, 0, 0, len(nodes), 0, tag, *nodes]
        for part in (entries[:19], entries[19:]):
            if part:
                yield f"{''.join(f'{number:10d}' for number in part)}\n"
    yield f"{-1:10d}\n"
    sets = dict(node_sets(source, elements))
    for group in source.groups:
        if group.dim == 3 and group.name in sets:  # a component is of nodes or of elements
            sets[group.name] = np.union1d(sets[group.name], elements[group.members])
        elif group.dim == 3:
            yield from _component(group.name, "ELEM", source.cell_tags[group.members].tolist())
    for name, nodes_of_set in sets.items():
        yield from _component(name, "NODE", tags[nodes_of_set].tolist())


def _real(value: float) -> str:
    mantissa, exponent = f"{value:.16E}".split("E")
    return f"{mantissa}E{int(exponent):+04d}".rjust(25)


def _component(name: str, kind: str, members: list[int]) -> Iterator[str]:
    yield f"CMBLOCK,{name},{kind},{len(members):8d}\n(8i10)\n"
    for start in range(0, len(members), _PER_LINE):
        yield f"{''.join(f'{number:10d}' for number in members[start : start + _PER_LINE])}\n"
