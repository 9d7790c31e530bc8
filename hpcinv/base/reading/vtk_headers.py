"""Headers of files in VTK's XML formats."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.parsers import expat

from hpcinv.base.reading.door import admitted

END = "/VTKFile"
"""tag by which `elements_of` ends a header that is whole"""


class _HeaderRead(Exception):
    pass


def elements_of(path: Path) -> Iterator[tuple[str, dict[str, str]]]:
    """Elements of the XML before appended data, which may not be XML, with their attributes; `END` if it is whole."""
    elements = list[tuple[str, dict[str, str]]]()
    parse(
        path,
        lambda tag, attributes: elements.append((END if tag == "AppendedData" else tag, attributes)),
        ends=lambda tag: elements.append((END, {})) if tag == "VTKFile" else None,
    )
    yield from elements


def parse(
    path: Path,
    begins: Callable[[str, dict[str, str]], object],
    has_text: Callable[[str], object] | None = None,
    ends: Callable[[str], object] | None = None,
) -> None:
    """Pass the elements of the XML before appended data to functions; VTK reports invalid XML."""

    def starts(tag: str, attributes: dict[str, str]) -> None:
        begins(tag, attributes)
        if tag == "AppendedData":
            raise _HeaderRead

    parser = expat.ParserCreate()
    parser.StartElementHandler = starts
    parser.buffer_text, parser.buffer_size = True, 1 << 20
    if has_text is not None:
        parser.CharacterDataHandler = has_text
    if ends is not None:
        parser.EndElementHandler = ends
    with contextlib.suppress(_HeaderRead, expat.ExpatError), admitted(path).open("rb") as file:
        parser.ParseFile(file)
