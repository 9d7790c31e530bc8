"""An archive of Ansys with other coordinates of its nodes: everything else stays as it is written."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from hpcinv.base.reading.cdb_files import block_format, is_end
from hpcinv.base.reading.fault import Fault
from hpcinv.errors import MeshError

_DIGITS = re.compile(r"[eg]\s*\d+\.(\d+)\s*(e\s*3)?", re.IGNORECASE)


def moved_archive(text: str, places: Mapping[int, Sequence[float]]) -> str:
    """Return an archive in which nodes have other coordinates, in its unit of length, with the digits of its blocks.

    Args:
        places: coordinates (3,) by the numbers of nodes; other nodes, such as pilots of contacts, stay.

    Raises:
        MeshError: a node is not in an ``NBLOCK``, or a block is damaged, with the line.
    """
    lines, left, row = text.splitlines(keepends=True), set(places), 0
    while row < len(lines):
        row += 1
        if lines[row - 1][:4].upper() != "NBLO" or row == len(lines):
            continue
        try:
            widths, real = block_format(lines[row], f"line {row + 1}")
        except Fault as fault:
            raise MeshError(fault.text, fault.advice) from None
        digits = _DIGITS.search(lines[row])
        row += 1
        while row < len(lines) and not is_end(lines[row]):
            number = lines[row][: widths[0]].strip()
            if number.isdigit() and (node := int(number)) in places and digits:
                left.discard(node)
                wide = _Field(real, int(digits[1]), 3 if digits[2] else 2)
                lines[row] = _moved(lines[row], sum(widths), wide, places[node])
            row += 1
    if left:
        raise MeshError(f"node {min(left)} of the mesh is not in its NBLOCK", "Give the archive of this run.")
    return "".join(lines)


class _Field:
    """A field of a number: its width, the digits after its point, and the digits of its exponent."""

    def __init__(self, width: int, digits: int, exponent: int) -> None:
        self.width, self._exponent = width, exponent
        self._digits = max(min(digits, width - exponent - 5), 1)  # next to both signs, a digit, the point and E

    def written(self, value: float) -> str:
        """Return a number in the field; one that is too small for its exponent is 0."""
        mantissa, exponent = f"{value if abs(value) > 1e-99 else 0.0:.{self._digits}E}".split("E")
        return f"{mantissa}E{int(exponent):+0{self._exponent + 1}d}".rjust(self.width)


def _moved(line: str, start: int, field: _Field, place: Sequence[float]) -> str:
    """Return a line of a node with other coordinates; angles of its axes, which follow, stay."""
    content = line.rstrip("\r\n")
    end, tail = line[len(content) :], content[start + 3 * field.width :]
    return f"{content[:start].ljust(start)}{''.join(map(field.written, place))}{tail}{end}"
