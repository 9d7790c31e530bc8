"""Universal files of I-deas (``.unv``, as gmsh and Salome write them): nodes, solid elements and groups.

Source: *Universal Dataset Number* 2411 (nodes), 2412 (elements), 2467 and its predecessors (groups).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.included_files import text_of
from hpcinv.base.reading.mesh_format import Later, MeshFormat
from hpcinv.base.reading.numbered_elements import Blocks, element_arrays, number, whole_numbers

if TYPE_CHECKING:
    import numpy as np

    from hpcinv.mesh.source import Floats, MeshSource
else:
    np = Later("numpy")


class Unv(MeshFormat):
    suffix = ".unv"
    action = "unv"
    elements = "a universal file"
    saver = "hpcinv.formats.unv:save_unv"
    saves_27_nodes = "never"


_SOLIDS = {
    111: tuple(range(4)),
    118: (0, 2, 4, 9, 1, 3, 5, 6, 7, 8),
    115: tuple(range(8)),
    116: (0, 2, 4, 6, 12, 14, 16, 18, 1, 3, 5, 7, 13, 15, 17, 19, 8, 9, 10, 11),
}
"""places of the nodes in the file; middle nodes are between the vertices of an edge"""
_KINDS = "of the types 111 and 118 (tetrahedra), 115 and 116 (hexahedra)"
_OTHER_SOLIDS = range(101, 120)
_BEAMS = (11, 21, 22, 23, 24)  # have a line more
_NODES, _ELEMENTS = (781, 2411), (780, 2412)
_GROUPS = (2435, 2452, 2467, 2477)
_NODE, _ELEMENT = 7, 8  # types of members of a group
_GENERAL = (151, 164, 2420, 15, *_NODES, *_ELEMENTS, *_GROUPS)


def read_unv(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return arrays of nodes, elements and groups; ``ignored`` are other datasets."""
    tags: list[int] = []
    points: list[list[float]] = []
    blocks, sets = Blocks(), dict[str, list[int]]()
    ignored = list[str]()
    for dataset, lines in _datasets(path):
        if dataset in _NODES:
            for at, line in lines:
                tags.append(whole_numbers(line.split()[:1], f"line {at}")[0])
                at, line = _next(lines)
                points.append([number(text, f"line {at}") for text in line.split()])
                if len(points[-1]) != 3:
                    raise Fault(f"line {at}: a node has {len(points[-1])} coordinates, not 3")
        elif dataset in _ELEMENTS:
            _read_elements(lines, blocks)
        elif dataset in _GROUPS:
            _read_groups(lines, sets)
        elif dataset not in _GENERAL:
            ignored.append(f"dataset {dataset}")
    return {"ignored": sorted(set(ignored))}, element_arrays(tags, points, blocks, sets, _KINDS)


type _Lines = Iterator[tuple[int, str]]


def _datasets(path: Path) -> Iterator[tuple[int, _Lines]]:
    """Yield the number and the lines of each dataset, which lines of -1 enclose."""
    inside: list[tuple[int, str]] | None = None
    is_empty = True
    for at, line in enumerate(text_of(path).splitlines(), 1):
        if line.strip() != "-1":
            if inside is not None:
                inside.append((at, line))
            continue
        if inside is None:
            inside = []
            continue
        if inside:
            is_empty = False
            yield whole_numbers(inside[0][1].split()[:1] or ["?"], f"line {inside[0][0]}")[0], iter(inside[1:])
        inside = None
    if inside is not None:
        raise Fault("its last dataset has no end", "Is the file complete?")
    if is_empty:
        raise Fault("has no datasets", "Is it a universal file?")


def _next(lines: _Lines) -> tuple[int, str]:
    entry = next(lines, None)
    if entry is None:
        raise Fault("a dataset ends too early", "Is the file complete?")
    return entry


def _read_elements(lines: _Lines, blocks: Blocks) -> None:
    for at, line in lines:
        head = whole_numbers(line.split(), f"line {at}")
        if len(head) != 6:
            raise Fault(f"line {at}: an element has {len(head)} numbers in its first line, not 6")
        tag, kind, count = head[0], head[1], head[5]
        if kind in _BEAMS:
            _next(lines)
        nodes: list[int] = []
        while len(nodes) < count:
            place, more = _next(lines)
            nodes += (entries := whole_numbers(more.split(), f"line {place}"))
            if not entries:
                raise Fault(f"line {place}: element {tag} has {len(nodes)} nodes, not {count}")
        if kind in _SOLIDS:
            if len(nodes) != len(_SOLIDS[kind]):
                raise Fault(f"line {at}: element {tag} of the type {kind} has {len(nodes)} nodes")
            blocks.add(tag, [nodes[i] for i in _SOLIDS[kind]])
        elif kind in _OTHER_SOLIDS:
            raise Fault(f"line {at}: elements of the type {kind} are not supported", f"Elements are {_KINDS}.")
        else:  # middle nodes of surface elements are between their vertices
            blocks.add_facet(tag, nodes[::2] if count in (6, 8) else nodes if count in (3, 4) else ())


def _read_groups(lines: _Lines, sets: dict[str, list[int]]) -> None:
    for at, line in lines:
        head = whole_numbers(line.split(), f"line {at}")
        if len(head) != 8:
            raise Fault(f"line {at}: a group has {len(head)} numbers in its first line, not 8")
        _, name = _next(lines)
        entries: list[int] = []
        while len(entries) < 4 * head[7]:
            place, more = _next(lines)
            entries += (numbers := whole_numbers(more.split(), f"line {place}"))
            if not numbers:
                raise Fault(f"line {place}: group {head[0]} has fewer members than its head says")
        if len(entries) % 4:
            raise Fault(f"line {at}: the members of group {head[0]} are not four numbers each")
        for kind, place_of in ((_NODE, "nodes"), (_ELEMENT, "cells")):
            if members := [tag for given, tag in zip(entries[::4], entries[1::4], strict=True) if given == kind]:
                sets.setdefault(f"{place_of}:{name.strip() or f'group-{head[0]}'}", []).extend(members)


_TYPES = {4: 111, 10: 118, 8: 115, 20: 116}
_FLAT_TYPES = {3: 91, 6: 92, 4: 94, 8: 95}
_ORDER = {
    10: (0, 4, 1, 5, 2, 6, 7, 8, 9, 3),
    20: (0, 8, 1, 9, 2, 10, 3, 11, 16, 17, 18, 19, 4, 12, 5, 13, 6, 14, 7, 15),
}
"""nodes of an element in the order of the file"""
_FLAT_ORDER = {6: (0, 3, 1, 4, 2, 5), 8: (0, 4, 1, 5, 2, 6, 3, 7)}
_PER_LINE = 8
"""nodes in a line"""


def save_unv(path: Path, source: MeshSource, points: Floats) -> None:
    """Write nodes, elements and groups at ``points`` (n, 3); facets of groups are shell elements.

    Raises:
        OSError: it cannot be written.
    """
    from hpcinv.formats.readers.elements import check_names, elements_of, facets_of

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
