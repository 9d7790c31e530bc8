"""Lines of input files of Abaqus and CalculiX, and of the files that they include.

``*INCLUDE, INPUT=FILE`` stands for the lines of a file, ``INPUT=FILE`` of ``*NODE``, ``*ELEMENT`` and ``*AMPLITUDE``
for their lines of data. Names are relative to the directory of the input file, or else of the file that includes them.
Source: *Abaqus Keywords Guide*, ``*INCLUDE``, ``*NODE``.
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import NamedTuple

from hpcinv.base.reading.abaqus_options import is_option
from hpcinv.base.reading.decoding import decoded
from hpcinv.base.reading.door import Refused, admitted
from hpcinv.base.reading.fault import Fault, shown

_INPUT = re.compile(r",\s*INPUT\s*=\s*(\"[^\"]*\"?|[^,]*)", re.IGNORECASE)
_INCLUDING = re.compile(r"\*\s*(INCLUDE|NODE|ELEMENT|AMPLITUDE)\s*(?:,|$)", re.IGNORECASE)
_DEEPEST = 20
"""levels of files in one another; Abaqus has at most five. Raised, a hostile file takes longer to be refused"""
_MOST_INCLUDES = 1000
"""files that are included, each as often as it is; raised, a hostile file takes longer to be refused"""
_REPEATED = 100 * 2**20
"""bytes of files that are included again; raised, a hostile file takes longer to be refused"""


class FileLine(NamedTuple):
    """A line of a file: its place, for messages, and its text without blanks at its ends."""

    place: str
    text: str


@dataclass
class Inclusions:
    """Files that one input file includes, counted, since each may include another one many times.

    Attributes:
        home: directory of the input file.
        most: bytes of all files; unlimited by default.
        names: the files, relative to that directory.
    """

    home: Path
    most: float = math.inf
    names: list[str] = field(default_factory=list)
    _sizes: dict[Path, int] = field(default_factory=dict)
    _count: int = 0
    _repeated: int = 0

    def find(self, name: str, above: tuple[Path, ...], place: str) -> Path:
        """Return the file of a name, which may be spelled as Windows does.

        Args:
            above: the files that include it, the first one outermost.

        Raises:
            Fault: it is missing, includes itself, or too much is included.
        """
        file = self._found(name, above[-1].parent, place)
        real = file.resolve()
        if real in above or len(above) > _DEEPEST:
            raise Fault(f"{place}: '{shown(file.name)}' includes itself", "Remove the line.")
        self._count += 1
        if real in self._sizes:
            self._repeated += self._sizes[real]
        self._sizes[real] = file.stat().st_size
        if self._count > _MOST_INCLUDES or self._repeated > _REPEATED:
            text = f"more than {_MOST_INCLUDES:,} files, or more than {_REPEATED:,} bytes again"
            raise Fault(f"{place}: includes {text}", "Include each file once.")
        if sum(self._sizes.values()) > self.most:
            raise Fault(f"{place}: includes more than {self.most:,} bytes")
        return file

    def _found(self, name: str, beside: Path, place: str) -> Path:
        spellings = dict.fromkeys((name, name.replace("\\", "/")))
        for file in (directory / text for text in spellings for directory in dict.fromkeys((self.home, beside))):
            if file.is_file():
                self.names.append(str(file.relative_to(self.home) if file.is_relative_to(self.home) else file))
                return admitted(file, self.home / name)
        advice = f"Put '{shown(Path(name.replace(chr(92), '/')).name)}' next to the file, and name it so."
        raise Fault(f"{place}: includes '{shown(name)}', which does not exist", advice)


def lines_of(path: Path, most: float = math.inf) -> Iterator[FileLine]:
    """Yield the lines that are neither empty nor comments; a keyword that is continued is one line.

    Args:
        most: bytes of included files.

    Raises:
        Fault: a file is missing, includes itself, or is not text; or too much is included.
    """
    yield from _lines(path, Inclusions(path.parent, most), ())


type Reader = Callable[[Path, Inclusions, tuple[Path, ...]], Iterator[FileLine]]


def included_by(path: Path, reader: Reader | None = None) -> tuple[list[str], bool]:
    """Return the names of all files that a file includes, relative to its directory, and whether all could be read."""
    inclusions, is_whole = Inclusions(path.parent), True
    try:
        for line in (reader or _lines)(path, inclusions, ()):
            del line
    except (Fault, Refused, OSError):  # reported by the reader
        is_whole = False
    return list(dict.fromkeys(inclusions.names)), is_whole


def _lines(path: Path, inclusions: Inclusions, above: tuple[Path, ...]) -> Iterator[FileLine]:
    inner = (*above, path.resolve())
    for number, head in joined_lines(StringIO(text_of(path, above), newline=None)):
        place = place_in(above, path, f"line {number}")
        including = _INCLUDING.match(head)
        is_include = including is not None and including[1].upper() == "INCLUDE"
        if not is_include:
            yield FileLine(place, head)
        if including is not None and (included := _INPUT.search(head)):
            file = inclusions.find(included[1].strip().strip('"').strip(), inner, place)
            yield from _lines(file, inclusions, inner)
        elif is_include:
            raise Fault(f"{place}: *INCLUDE needs INPUT=")


def joined_lines(lines: Iterable[str]) -> Iterator[tuple[int, str]]:
    """Yield lines with their numbers, without empty ones and comments.

    A keyword that ends with a comma is continued by a line that begins with an option of it, as Abaqus does. CalculiX
    continues none: a line of data after such a keyword is data in both programs.
    """
    head, place = "", 0  # a keyword that ends with a comma
    for number, line in enumerate(lines, 1):
        stripped = line.strip()
        if not stripped or stripped.startswith("**"):
            continue
        if head:
            if not stripped.startswith("*") and _continues(head, stripped):
                stripped = head + stripped
            else:
                yield place, head.rstrip(", ")
            head = ""
        if stripped[0] == "*" and stripped[-1] == ",":
            head, place = stripped, number
        else:
            yield number, stripped
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


def place_in(above: tuple[Path, ...], path: Path, text: str) -> str:
    """Return a place in a file; the file that is not included is named by the message."""
    return f"{shown(path.name)}, {text}" if above else text
