"""The grammar of FEBio's model files (``.feb``): their XML, the names in it, and fibres between nodes of elements."""

import xml.etree.ElementTree as ET
from pathlib import Path
from xml.parsers import expat

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.fault import Fault

_NAMED = ("Nodes", "Elements", "NodeSet", "ElementSet", "Surface")
"""elements of a file that name regions"""


def model_of(content: bytes) -> ET.Element:
    """Return the root of a model; ``Fault`` if it is not XML, or defines entities."""
    _refuse_entities(content)
    try:
        return ET.fromstring(content)
    except (ET.ParseError, LookupError) as error:  # an unknown encoding
        raise Fault(f"is not XML: {error}", "Is the file complete?") from None


def _refuse_entities(content: bytes) -> None:
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise Fault("has definitions of entities, which could fill the memory", "Save the model again.")


def names_in(path: Path) -> list[str]:
    """Return the names of parts, sets and surfaces of a model, without its content; ``Fault`` if it is not XML."""
    content, names, parser = admitted(path).read_bytes(), list[str](), expat.ParserCreate()
    _refuse_entities(content)

    def note(tag: str, attributes: dict[str, str]) -> None:
        if tag in _NAMED and "name" in attributes:
            names.append(attributes["name"])

    parser.StartElementHandler = note
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, LookupError) as error:
        raise Fault(f"is not XML: {error}", "Is the file complete?") from None
    return names


def local_nodes(text: str) -> tuple[int, int]:
    """Return the numbers, from 1, of the nodes from and to which fibres point.

    Raises:
        ValueError: they are not two different nodes.
    """
    first, second = (int(entry) for entry in text.replace(",", " ").split())
    if first <= 0 and second <= 0:  # FEBio's default
        first, second = 1, 2
    if first <= 0 or second <= 0 or first == second:
        raise ValueError(f"{text!r} are not two different nodes")
    return first, second


def local_name(nodes: tuple[int, int]) -> str:
    """Return the name of the array of the directions of fibres between two nodes of each element."""
    return f"local-{nodes[0]}-{nodes[1]}"
