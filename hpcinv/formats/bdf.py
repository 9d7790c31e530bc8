"""Bulk data of Nastran: properties and sets are regions."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hpcinv.base.reading.mesh_format import Later, MeshFormat
from hpcinv.formats.exodus import BRICK
from hpcinv.formats.readers.followed_includes import included_files

if TYPE_CHECKING:
    import numpy as np

    from hpcinv.mesh.source import Floats, MeshSource
else:
    np = Later("numpy")


class Bdf(MeshFormat):
    suffix = ".bdf"
    other_suffixes = (".nas", ".fem")
    action = "bdf"
    elements = "bulk data of Nastran"
    saver = "hpcinv.formats.bdf:save_bdf"
    saves_27_nodes = "never"

    def data_files(self, path: Path, *, isolated: bool | None = None) -> list[str]:
        """Files that it includes."""
        return included_files("bdf-files", path, isolated=isolated)


_LARGEST = 99_999_999
"""number in a field of 8 characters"""
_WIDE = 16
"""characters of a coordinate, the most that Nastran reads"""
_NAMES = {"tetrahedron": "CTETRA", "hexahedron": "CHEXA"}
_PROPERTY = re.compile(r"property-(\d{1,8})")


def save_bdf(path: Path, source: MeshSource, points: Floats) -> None:
    """Write grid points, elements and sets at ``points`` (n, 3); a region of facets is a set of grid points.

    A field has 16 characters, which hold 10 to 14 digits of a coordinate.

    Raises:
        OSError: it cannot be written.
    """
    from hpcinv.formats.readers.elements import check_names, check_numbers, disjoint_parts, elements_of, node_sets

    check_names(source, r"[^\"\n$]+", "Rename the region.")
    elements = elements_of(source)
    used, tags = np.unique(elements), source.node_tags
    check_numbers(source, _LARGEST)
    order = list(BRICK.get(elements.shape[1], range(elements.shape[1])))
    part, blocks, others = disjoint_parts(source)
    taken = {int(match[1]) for group in blocks if (match := _PROPERTY.fullmatch(group.name))}
    free = (number for number in range(1, _LARGEST) if number not in taken)
    properties = [int(match[1]) if (match := _PROPERTY.fullmatch(g.name)) else next(free) for g in blocks]
    properties.append(next(free))  # of cells without a group
    with path.open("w", encoding="latin-1") as file:
        file.write("$ Written by hpcinv\nBEGIN BULK\n")
        for group, number in zip(blocks, properties, strict=False):
            file.write(f'$HMNAME PROP    {number:8d}"{group.name}"\n')
        for tag, position in zip(tags[used].tolist(), points[used].tolist(), strict=True):
            x, y, z = map(_real, position)
            file.write(f"{'GRID*':8}{tag:16d}{'':16}{x:>16}{y:>16}*\n{'*':8}{z:>16}\n")
        rows = zip(source.cell_tags.tolist(), part.tolist(), tags[elements[:, order]].tolist(), strict=True)
        for tag, owner, nodes in rows:
            file.writelines(_card(_NAMES[source.kind], [tag, properties[owner], *nodes]))
        sets = [(1, "GRID", name, tags[members]) for name, members in node_sets(source, elements)]
        sets += [(2, "ELEM", group.name, source.cell_tags[group.members]) for group in others]
        for number, (kind, word, name, members) in enumerate(sets, 1):
            file.write(f'$HMSET {number:8d}{kind:9d} "{name}"\n')
            file.writelines(_card("SET3", [number, word, *members.tolist()]))
        file.write("ENDDATA\n")


def _card(name: str, entries: Sequence[int | str]) -> Iterator[str]:
    for start in range(0, len(entries), 8):
        yield f"{name if start == 0 else '+':8}{''.join(f'{entry:>8}' for entry in entries[start : start + 8])}\n"


def _real(value: float) -> str:
    """Return the text of a number with the most digits that a field holds; it has a point."""
    shortest = repr(value)
    if len(shortest) <= _WIDE and "e" not in shortest:
        return shortest
    for digits in range(_WIDE, 1, -1):
        mantissa, exponent = f"{value:.{digits}e}".split("e")
        text = f"{mantissa}{int(exponent):+d}"
        plain = f"{value:.{digits}f}"
        if len(plain) <= _WIDE and float(plain) and abs(float(plain) - value) <= abs(value) * 10.0 ** (1 - digits):
            return plain
        if len(text) <= _WIDE:
            return text
    return "0.0"
