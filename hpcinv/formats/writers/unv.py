"""Universal files of I-deas, read and written."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from hpcinv.formats.readers.elements import check_names, elements_of, facets_of
from hpcinv.mesh.source import Floats, MeshSource

_TYPES = {4: 111, 10: 118, 8: 115, 20: 116}
_FLAT_TYPES = {3: 91, 6: 92, 4: 94, 8: 95}
_ORDER = {
    10: (0, 4, 1, 5, 2, 6, 7, 8, 9, 3),
    20: (0, 8, 1, 9, 2, 10, 3, 11, 16, 17, 18, 19, 4, 12, 5, 13, 6, 14, 7, 15),
}
"""nodes of an element in the order of the file"""
_FLAT_ORDER = {6: (0, 3, 1, 4, 2, 5), 8: (0, 4, 1, 5, 2, 6, 3, 7)}
_ELEMENT = 8
_PER_LINE = 8
"""nodes in a line"""


def save_unv(path: Path, source: MeshSource, points: Floats) -> None:
    """Write nodes, elements and groups at ``points`` (n, 3); facets of groups are shell elements.

    Raises:
        OSError: it cannot be written.
    """
    check_names(source, r"[^\n]{1,80}", "Names have up to 80 characters; rename the region.")
    elements = elements_of(source)
    used, tags = np.unique(elements), source.node_tags
    facets = facets_of(source, elements)
    facet_tags = source.cell_tags.max() + 1 + np.arange(len(facets))
    with path.open("w", encoding="latin-1") as file:
        file.write("    -1\n  2411\n")
        for tag, position in zip(tags[used].tolist(), points[used].tolist(), strict=True):
            file.write(f"{tag:10d}{1:10d}{1:10d}{11:10d}\n")
            file.write(f"{''.join(f'{value:25.16E}'.replace('E', 'D') for value in position)}\n")
        file.write("    -1\n    -1\n  2412\n")
        file.writelines(_elements(_TYPES, _ORDER, source.cell_tags.tolist(), tags[elements].tolist()))
        file.writelines(_elements(_FLAT_TYPES, _FLAT_ORDER, facet_tags.tolist(), tags[facets].tolist()))
        file.write("    -1\n    -1\n  2467\n")
        for number, group in enumerate(source.groups, 1):
            members = (source.cell_tags if group.dim == 3 else facet_tags)[group.members].tolist()
            file.write(f"{number:10d}{''.join(f'{entry:10d}' for entry in (0, 0, 0, 0, 0, 0, len(members)))}\n")
            file.write(f"{group.name}\n")
            for start in range(0, len(members), 2):
                rows = (f"{_ELEMENT:10d}{tag:10d}{0:10d}{0:10d}" for tag in members[start : start + 2])
                file.write(f"{''.join(rows)}\n")
        file.write("    -1\n")


def _elements(
    types: dict[int, int], orders: Mapping[int, Sequence[int]], tags: list[int], rows: list[list[int]]
) -> Iterator[str]:
    for tag, nodes in zip(tags, rows, strict=True):
        ordered = [nodes[i] for i in orders.get(len(nodes), range(len(nodes)))]
        yield f"{''.join(f'{entry:10d}' for entry in (tag, types[len(nodes)], 1, 1, 7, len(nodes)))}\n"
        for start in range(0, len(ordered), _PER_LINE):
            yield f"{''.join(f'{node:10d}' for node in ordered[start : start + _PER_LINE])}\n"
