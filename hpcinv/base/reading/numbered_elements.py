"""Nodes, solid elements and sets that a file names by numbers, as arrays of rows; what does not fit is a fault."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from hpcinv.base.reading.fault import Fault, shown
from hpcinv.base.reading.mesh_format import Later

if TYPE_CHECKING:
    import numpy as np
else:
    np = Later("numpy")

type Sets = Mapping[str, Sequence[Any]]

LARGEST = 2**53
"""number of a node or element; raised, doubles of some formats no longer have all integers"""
_SHORT = {3: 3, 6: 3, 7: 3, 4: 4, 8: 4, 9: 4}
"""vertices of a facet by its number of nodes"""


class Blocks:
    """Elements as a file lists them: solids by number of nodes, and surface elements by the name of their set."""

    def __init__(self) -> None:
        self.solids: dict[int, tuple[list[int], list[Sequence[int]]]] = {}
        self.skins: dict[str, list[Sequence[int]]] = {}
        self.others: dict[int, Sequence[int]] = {}  # vertices of surface elements, by number

    def add(self, number: int, nodes: Sequence[int]) -> None:
        numbers, cells = self.solids.setdefault(len(nodes), ([], []))
        numbers.append(number)
        cells.append(nodes)

    def add_facet(self, number: int, vertices: Sequence[int], name: str = "") -> None:
        """Add a surface element, to a set if it has a name."""
        self.others[number] = vertices
        if name:
            self.skins.setdefault(name, []).append(vertices)

    def only_solids(self, kinds: str) -> tuple[list[int], list[Sequence[int]]]:
        """Return numbers and nodes of the solid elements; ``Fault`` if there are none, or several kinds."""
        if not self.solids:
            raise Fault("has no solid elements", f"Elements are {kinds}.")
        if len(self.solids) > 1:
            sizes = " and ".join(map(str, sorted(self.solids)))
            raise Fault(f"has elements of {sizes} nodes", "Use one kind of elements.")
        (solids,) = self.solids.values()
        return solids

    def solids_among(self, members: Sequence[int], name: str) -> list[int]:
        """Return the solid elements of a set; its surface elements become facets of the set."""
        for number in members:
            if facet := self.others.get(number):
                self.skins.setdefault(name, []).append(facet)
        return [number for number in members if number not in self.others]


def vertices_of(nodes: Sequence[int]) -> Sequence[int]:
    """Return the vertices of a surface element whose middle nodes follow them."""
    return nodes[: _SHORT.get(len(nodes), 0)]


def element_arrays(node_tags: Any, points: Any, blocks: Blocks, sets: Sets, kinds: str) -> dict[str, Any]:
    """Return arrays as `hpcinv.base.reading.inp_files.read_inp` does.

    Args:
        node_tags: (n,) numbers of the nodes.
        points: (n, 3).
        sets: numbers of members by name: ``nodes:NAME`` and ``cells:NAME``. Elements of a set that are not solid are
            facets of it.
        kinds: elements that are read, for a message.
    """
    tags = integers(node_tags, "numbers of nodes")
    positions = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    if len(tags) != len(positions):
        raise Fault(f"has {len(tags):,} numbers of nodes and {len(positions):,} positions", "Is the file complete?")
    if (bad := ~np.isfinite(positions).all(axis=1)).any():
        raise Fault(f"node {tags[bad][0]} has a coordinate that is not finite")
    numbers, cells = blocks.only_solids(kinds)
    node_rows = _NumberedRows(tags, "node")
    cell_tags = integers(numbers, "numbers of elements")
    cell_rows = _NumberedRows(cell_tags, "element")
    table = integers(cells, "nodes of elements")
    arrays: dict[str, Any] = {
        "points": positions,
        "node_tags": tags,
        "cells": node_rows.of(table, lambda row: f"element {cell_tags[row]}"),
        "cell_tags": cell_tags,
    }
    for key, members in sets.items():
        place, _, name = key.partition(":")
        if place == "cells":
            members = blocks.solids_among(members, name)
        if len(members):
            rows = node_rows if place == "nodes" else cell_rows
            listed = integers(members, f"members of set '{shown(name)}'")
            arrays[key] = np.unique(rows.of(listed[:, None], lambda _, name=name: f"set '{shown(name)}'"))
    size = 3 if table.shape[1] in (4, 10) else 4
    for name, facets in blocks.skins.items():
        if fitting := [facet for facet in facets if len(facet) == size]:
            rows_of_facets = integers(fitting, f"nodes of set '{shown(name)}'")
            arrays[f"skin:{name}"] = node_rows.of(rows_of_facets, lambda _, name=name: f"set '{shown(name)}'")
    return arrays


def integers(values: Any, what: str) -> Any:
    """Return values as an array of 64-bit integers."""
    try:
        numbers = np.array(values, dtype=np.int64)
    except (OverflowError, ValueError, TypeError):
        raise Fault(f"its {what} are not whole numbers of a valid size", "Is the file complete?") from None
    if numbers.size and np.abs(numbers).max() > LARGEST:
        raise Fault(f"its {what} are beyond {LARGEST:.0e}", "Is the file complete?")
    return numbers


class _NumberedRows:
    """Rows of numbered nodes or elements."""

    def __init__(self, tags: Any, what: str) -> None:
        self._order = np.argsort(tags, kind="stable")
        self._sorted, self._what = tags[self._order], what
        twice = self._sorted[1:] == self._sorted[:-1]
        if twice.any():
            raise Fault(f"{what} {self._sorted[1:][twice][0]} is defined twice", "Number them again.")

    def of(self, tags: Any, owner: Any) -> Any:
        """Return rows of numbers (m, k); ``owner`` names the row of one that is not defined."""
        if not len(self._sorted):
            raise Fault(f"has no {self._what}s", "Is the file complete?")
        place = np.searchsorted(self._sorted, tags).clip(max=len(self._sorted) - 1)
        if (missing := self._sorted[place] != tags).any():
            row = int(np.flatnonzero(missing.any(axis=-1))[0])
            text = f"{owner(row)} has {self._what} {tags[missing][0]}, which is not defined"
            raise Fault(text, "Is the file complete?")
        return self._order[place]


def number(text: str, place: str) -> float:
    """Return a number, whose exponent may be Fortran's (``1.5D+2``) or have no letter (``1.5+2``)."""
    short = text.strip().upper().replace("D", "E")
    at = max(short.rfind("+"), short.rfind("-"))
    if at > 0 and short[at - 1] not in "E":
        short = f"{short[:at]}E{short[at:]}"
    try:
        return float(short or "0")
    except ValueError:
        raise Fault(f"{place}: '{shown(text.strip())}' is not a number", "Is the file complete?") from None


def whole_number(text: str, place: str) -> int:
    """Return a whole number of at most `LARGEST`."""
    try:
        value = int(text)
    except ValueError:
        raise Fault(f"{place}: '{shown(text.strip())}' is not a whole number", "Is the file complete?") from None
    if abs(value) > LARGEST:
        raise Fault(f"{place}: '{shown(text.strip())}' is beyond {LARGEST:.0e}", "Is the file complete?")
    return value


def whole_numbers(texts: Iterable[str], place: str) -> list[int]:
    """Return the whole numbers of texts that are not empty."""
    return [whole_number(text, place) for text in texts if text.strip()]


def all_in(numbers: Collection[int], known: Collection[int]) -> bool:
    """Return whether there are numbers, and all of them are known."""
    return bool(numbers) and all(entry in known for entry in numbers)
