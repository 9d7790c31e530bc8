"""Lines of input files of Abaqus and CalculiX, and of the files that they include.

``*INCLUDE, INPUT=FILE`` stands for the lines of a file, ``INPUT=FILE`` of ``*NODE``, ``*ELEMENT`` and ``*AMPLITUDE``
for their lines of data. Names are relative to the directory of the input file, or else of the file that includes them.
Source: *Abaqus Keywords Guide*, ``*INCLUDE``, ``*NODE``.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from io import StringIO
from pathlib import Path
from typing import NamedTuple

from hpcinv.reading.abaqus_options import is_option
from hpcinv.reading.decoding import decoded
from hpcinv.reading.door import Refused, admitted
from hpcinv.reading.fault import Fault, shown

_INPUT = re.compile(r",\s*INPUT\s*=\s*(\"[^\"]*\"?|[^,]*)", re.IGNORECASE)
_INCLUDING = re.compile(r"\*\s*(INCLUDE|NODE|ELEMENT|AMPLITUDE)\s*(?:,|$)", re.IGNORECASE)
_DEEPEST = 20
"""Levels of files in one another; Abaqus has at most five. Raised, a hostile file takes longer to be refused."""


class FileLine(NamedTuple):
    """A line of a file: its place, for messages, and its text without blanks at its ends."""

    place: str
    text: str


def lines_of(path: Path) -> Iterator[FileLine]:
    """Yield the lines that are neither empty nor comments; a keyword that is continued is one line.

    Raises:
        Fault: a file is missing, includes itself, or is not text.
    """
    yield from _lines(path, path.parent, ())


type Reader = Callable[[Path, Path, tuple[Path, ...], list[str]], Iterator[FileLine]]


def included_by(path: Path, reader: Reader | None = None) -> list[str]:
    """Return the names of all files that a file includes, relative to its directory, as far as they can be read."""
    names: list[str] = []
    try:
        for line in (reader or _lines)(path, path.parent, (), names):
            del line
    except (Fault, Refused, OSError):  # reported by the reader
        pass
    return list(dict.fromkeys(names))


def _lines(path: Path, home: Path, above: tuple[Path, ...], names: list[str] | None = None) -> Iterator[FileLine]:
    inner = (*above, path.resolve())
    for number, head in joined_lines(StringIO(text_of(path, above), newline=None)):
        place = place_in(above, path, f"line {number}")
        including = _INCLUDING.match(head)
        is_include = including is not None and including[1].upper() == "INCLUDE"
        if not is_include:
            yield FileLine(place, head)
        if including is not None and (included := _INPUT.search(head)):
            file = found_file(included[1].strip().strip('"').strip(), home, path.parent, place, names)
            check_loop(file, inner, place)
            yield from _lines(file, home, inner, names)
        elif is_include:
            raise Fault(f"{place}: *INCLUDE needs INPUT=")


def joined_lines(lines: Iterable[str]) -> Iterator[tuple[int, str]]:
    """Yield lines with their numbers, without empty ones and comments.

    A keyword that ends with a comma is continued by a line that begins with an option of it, as Abaqus does. CalculiX
    continues none: a line of data after such a keyword is data in both programs.
    """
    head, place = "", 0
    for number, line in enumerate(lines, 1):
        stripped = line.strip()
        if not stripped or stripped.startswith("**"):
            continue
        if head and not stripped.startswith("*") and _continues(head, stripped):
            head, place = head + stripped, number
        else:
            if head:
                yield place, head.rstrip(", ")
            head, place = stripped, number
        if not (head.startswith("*") and head.endswith(",")):
            yield place, head
            head = ""
    if head:
        yield place, head.rstrip(", ")


def _continues(head: str, line: str) -> bool:
    """Return whether a line begins with an option of a keyword."""
    return is_option(head[1:].partition(",")[0], line.partition(",")[0])


def text_of(path: Path, above: tuple[Path, ...] = ()) -> str:
    """Return the text of a file; ``Fault`` if it is not text.

    Args:
        above: the files that include it, the first one outermost.
    """
    try:
        return decoded(admitted(path).read_bytes())[0]
    except ValueError:
        raise Fault(place_in(above, path, "is not a text file"), "Save it as text, in UTF-8.") from None


def check_loop(file: Path, above: tuple[Path, ...], place: str) -> None:
    """Raise ``Fault`` if a file is one of those that include it."""
    if file.resolve() in above or len(above) > _DEEPEST:
        raise Fault(f"{place}: '{shown(file.name)}' includes itself", "Remove the line.")


def place_in(above: tuple[Path, ...], path: Path, text: str) -> str:
    """Return a place in a file; the file that is not included is named by the message."""
    return f"{shown(path.name)}, {text}" if above else text


def found_file(name: str, home: Path, beside: Path, place: str, names: list[str] | None) -> Path:
    """Return the file of a name, which may be spelled as Windows does."""
    spellings = dict.fromkeys((name, name.replace("\\", "/")))
    for file in (directory / spelled for spelled in spellings for directory in dict.fromkeys((home, beside))):
        if file.is_file():
            if names is not None:
                names.append(str(file.relative_to(home) if file.is_relative_to(home) else file))
            return admitted(file, home / name)
    advice = f"Put '{shown(Path(name.replace(chr(92), '/')).name)}' next to the file, and name it so."
    raise Fault(f"{place}: includes '{shown(name)}', which does not exist", advice)
