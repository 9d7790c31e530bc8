"""Data of elements in FEBio's model files (format 4.0): vectors, such as directions of fibres."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hpcinv.base.reading.fault import Fault, shown

_MOST = 27
"""nodes of an element"""


def directions_in(root: ET.Element, sets: Mapping[str, Sequence[int]], cell_tags: Sequence[int]) -> dict[str, Any]:
    """Return vectors (elements, 3) by the name of their data, 0 where there are none; mean of those at the nodes.

    Args:
        sets: numbers of elements by the name of their set, in its order.

    Raises:
        Fault: data are damaged.
    """
    rows = {tag: row for row, tag in enumerate(cell_tags)}
    found: dict[str, Any] = {}
    for data in root.findall("MeshData/ElementData"):
        name, tags = data.get("name", ""), sets.get(data.get("elem_set", ""))
        if data.get("data_type") != "vec3" or data.get("type") or not name or tags is None:
            continue
        values = found.setdefault(name, np.zeros((len(cell_tags), 3)))
        for entry in data:
            place = _place(entry, len(tags), name)
            if (row := rows.get(tags[place])) is not None:
                values[row] = _vector(entry.text or "", name)
    return found


def _place(entry: ET.Element, count: int, name: str) -> int:
    text = entry.get("lid", "")
    if not text.isdecimal() or not 0 < int(text) <= count:
        raise Fault(f"data '{shown(name)}' have an element lid='{shown(text)}', not 1 to {count}")
    return int(text) - 1


def _vector(text: str, name: str) -> Any:
    try:
        numbers = np.array(text.replace(",", " ").split(), dtype=np.float64)
    except ValueError:
        numbers = np.zeros(0)
    if not 0 < len(numbers) <= 3 * _MOST or len(numbers) % 3 or not np.isfinite(numbers).all():
        raise Fault(f"data '{shown(name)}' have an entry that is not three numbers, or three at each node")
    return numbers.reshape(-1, 3).mean(axis=0)
