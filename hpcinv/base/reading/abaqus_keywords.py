"""Keywords of input files of Abaqus and CalculiX, with their options and lines of data."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import cos, radians, sin

from hpcinv.base.reading.abaqus_options import spelled
from hpcinv.base.reading.fault import Fault, shown
from hpcinv.base.reading.included_files import joined_lines


@dataclass(frozen=True)
class Keyword:
    """A keyword.

    Attributes:
        place: of its line in the file.
        name: in upper case.
        options: values by name in upper case; empty for those without a value.
        rows: place and entries of each line of data. Entries that are left out are empty, those at the end are missing.
    """

    place: str
    name: str
    options: Mapping[str, str]
    rows: list[tuple[str, list[str]]]

    @property
    def lines(self) -> list[list[str]]:
        """Entries of the lines of data."""
        return [entries for _, entries in self.rows]


def keywords(lines: Iterable[tuple[str, str]]) -> Iterator[Keyword]:
    """Yield the keywords of lines with their places; lines before the first one have a keyword of no name."""
    keyword: Keyword | None = None
    for place, line in lines:
        if line.startswith("*"):
            if keyword is not None:
                yield keyword
            keyword = _keyword(line, place)
        else:
            keyword = keyword or Keyword(place, "", {}, [])
            keyword.rows.append((place, _entries(line)))
    if keyword is not None:
        yield keyword


def keywords_of_text(text: str) -> list[Keyword]:
    """Return the keywords of a text, which has the files that it includes, without their places."""
    lines = (("", line) for _, line in joined_lines(text.splitlines()))
    return [keyword for keyword in keywords(lines) if keyword.name]


def position_of(coordinates: Sequence[float], system: str, place: str) -> tuple[float, float, float]:
    """Return a position of ``*NODE`` by its coordinates in a system; those left out are 0.

    Args:
        system: R, C (radius, degrees about z, z) or S (radius, degrees about z, degrees above the plane x-y).

    Raises:
        Fault: it is another one.
    """
    first, second, third = [*coordinates, 0.0, 0.0, 0.0][:3]
    kind = system[:1].upper() or "R"
    if kind == "R":
        return first, second, third
    if kind not in ("C", "S"):
        raise Fault(f"{place}: *NODE, SYSTEM={shown(system)} is not R, C or S")
    angle, up = radians(second), radians(third)
    if kind == "C":
        return first * cos(angle), first * sin(angle), third
    return first * cos(up) * cos(angle), first * cos(up) * sin(angle), first * sin(up)


def _entries(line: str) -> list[str]:
    """Return the entries of a line of data."""
    entries = [entry.strip() for entry in line.split(",")]
    if '"' in line:
        entries = [entry.strip('"') for entry in entries]
    while len(entries) > 1 and not entries[-1]:
        entries.pop()
    return entries


def _keyword(head: str, place: str) -> Keyword:
    title, *entries = (entry.strip() for entry in head[1:].split(","))
    pairs = (entry.partition("=") for entry in entries if entry)
    options = {spelled(name): value.strip().strip('"').strip() for name, _, value in pairs}
    return Keyword(place, spelled(title), options, [])
