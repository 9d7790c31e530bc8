"""A deck of CalculiX or Abaqus with other coordinates of its nodes: everything else stays as it is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hpcinv.base.reading.abaqus_keywords import Keyword, keywords
from hpcinv.errors import MeshError
from hpcinv.formats.inp import number

_FROM_OTHERS = ("NGEN", "NFILL", "NCOPY", "NMAP", "SYSTEM", "INCLUDE")
"""keywords by which nodes or coordinates follow from others, or are in another file"""


def moved_deck(text: str, places: Mapping[int, Sequence[float]]) -> str:
    """Return a deck in which nodes have other coordinates, in its unit of length.

    Args:
        places: coordinates (3,) by the numbers of nodes; other nodes, such as reference points, stay.

    Raises:
        MeshError: a node is not written in it by its number and coordinates, with the line that says where it is from.
    """
    lines, left = text.splitlines(keepends=True), set(places)
    within, parts = "", 0
    for i, line in enumerate(lines):
        if line.startswith("**") or not line.strip():
            continue
        if line.startswith("*"):
            [card] = keywords([(f"line {i + 1}", line.strip())])
            parts += card.name == "PART"
            _check(card, parts)
            within = card.name
        elif within == "INSTANCE":
            raise MeshError(f"line {i + 1}: *INSTANCE moves or turns its part: nodes are elsewhere")
        elif within == "NODE":
            tag, *rest = line.rstrip("\r\n").split(",")
            if tag.strip().isdigit() and (node := int(tag)) in places:
                if any(entry.strip() for entry in rest[3:]):
                    raise MeshError(f"line {i + 1}: node {node} has a direction, which another shape would turn")
                left.discard(node)
                end = line[len(line.rstrip("\r\n")) :]
                lines[i] = ", ".join([tag, *map(number, places[node])]) + end
    if left:
        raise MeshError(f"node {min(left)} of the mesh is not among its lines of *NODE", "Give the deck of this run.")
    return "".join(lines)


def _check(card: Keyword, parts: int) -> None:
    """Raise ``MeshError`` for a keyword by which nodes are elsewhere than the lines of ``*NODE`` say."""
    if card.name in _FROM_OTHERS or (card.name == "NODE" and card.options.get("INPUT")):
        raise MeshError(f"{card.place}: *{card.name}: nodes do not have their coordinates in this file alone")
    if card.name == "NODE" and card.options.get("SYSTEM", "R")[:1].upper() != "R":
        raise MeshError(f"{card.place}: *NODE, SYSTEM={card.options['SYSTEM']}: coordinates are not x, y, z")
    if card.name == "PART" and parts > 1:
        raise MeshError(f"{card.place}: *PART: several parts may have nodes of the same number")
