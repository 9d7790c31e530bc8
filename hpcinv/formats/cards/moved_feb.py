"""A model of FEBio with other coordinates of its nodes: everything else stays as it is written."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from hpcinv.errors import MeshError

_TOKEN = re.compile(r"<!--.*?-->|<Nodes\b[^>]*>|</Nodes>|<node\b(?P<attributes>[^>]*)>(?P<place>[^<]*)</node>", re.S)
_ID = re.compile(r"""\bid\s*=\s*["']\s*(\d+)\s*["']""")


def moved_model(text: str, places: Mapping[int, Sequence[float]]) -> str:
    """Return a model in which nodes have other coordinates, in its unit of length.

    Args:
        places: coordinates (3,) by the numbers of nodes; other nodes stay.

    Raises:
        MeshError: a node is not written in it, or is written twice, with its number.
    """
    left, parts, at, is_inside = set(places), list[str](), 0, False
    for token in _TOKEN.finditer(text):
        if token["attributes"] is None:
            if not token[0].startswith("<!--"):
                is_inside = token[0].startswith("<Nodes") and not token[0].endswith("/>")
            continue
        found = _ID.search(token["attributes"]) if is_inside else None
        if found is None or (node := int(found[1])) not in places:
            continue
        if node not in left:
            line = text.count("\n", 0, token.start()) + 1
            raise MeshError(f"line {line}: node {node} is written twice", "Number the nodes of all parts differently.")
        left.discard(node)
        parts += [text[at : token.start("place")], ",".join(repr(float(entry)) for entry in places[node])]
        at = token.end("place")
    if left:
        raise MeshError(f"node {min(left)} of the mesh is not among its <Nodes>", "Give the model of this run.")
    return "".join([*parts, text[at:]])
