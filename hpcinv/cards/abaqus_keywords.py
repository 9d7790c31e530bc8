"""Keywords of input files of Abaqus and CalculiX."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from hpcinv.reading.included_files import joined_lines


@dataclass(frozen=True)
class Keyword:
    """A keyword with its parameters, and the entries of its lines of data."""

    name: str
    parameters: Mapping[str, str]
    lines: list[list[str]]


def keywords(text: str) -> Iterator[Keyword]:
    """Yield the keywords of an input file; comments are left out."""
    keyword: Keyword | None = None
    for _, line in joined_lines(text.splitlines()):
        if line.startswith("*"):
            if keyword is not None:
                yield keyword
            keyword = _keyword(line)
        elif keyword is not None:
            keyword.lines.append([entry.strip() for entry in line.removesuffix(",").split(",")])
    if keyword is not None:
        yield keyword


def _keyword(head: str) -> Keyword:
    title, *entries = (" ".join(part.split()) for part in head.removeprefix("*").split(","))
    pairs = (entry.partition("=") for entry in entries if entry)
    return Keyword(title.upper(), {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}, [])
