"""Bulk data of Nastran (``.bdf``, ``.nas``): grid points, solid elements, properties and sets.

Fields are of 8 or 16 characters, or between commas. HyperMesh writes names of sets and properties into comments.
Source: *MSC Nastran Quick Reference Guide*, "Bulk Data Entries".
"""

import contextlib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from hpcinv.base.reading.bdf_frames import BY_NODES, KINDS, CoordinateCard, Frames
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.included_files import FileLine, Inclusions, place_in, text_of
from hpcinv.base.reading.numbered_elements import (
    Blocks,
    all_in,
    element_arrays,
    number,
    vertices_of,
    whole_number,
    whole_numbers,
)

_SOLIDS = {"CTETRA": (4, 10), "CHEXA": (8, 20)}
_FLAT = {"CTRIA3": 3, "CTRIAR": 3, "CTRIA6": 6, "CQUAD4": 4, "CQUADR": 4, "CQUAD8": 8}
_KINDS = "CTETRA (4 or 10 nodes) and CHEXA (8 or 20 nodes)"
_BRICK = (
    *range(12),
    *range(16, 20),
    *range(12, 16),
)  # middle nodes of upright edges come before the nodes of top edges
_NAME = re.compile(r"\$HM(SET|NAME\s+PROP)\s+(\d+)\s*(\d*)\s*\"([^\"]+)\"")
_CASE_SET = re.compile(r"SET\s+(\d+)\s*=\s*(.*)", re.I)
_BEGIN = re.compile(r"\s*BEGIN\s+BULK", re.I)
_INCLUDE = re.compile(r"\s*INCLUDE\b", re.I)
_LONGEST_COMMAND = 10_000
"""characters of one INCLUDE; raised, a hostile file takes longer to be refused"""
_GENERAL = ("PARAM", "ENDDATA", "PSOLID", "PSHELL", "BEGIN", "SOL", "CEND")


@dataclass
class _Card:
    place: str
    name: str
    fields: list[str]


@dataclass
class _Deck:
    names: dict[tuple[str, int], str] = field(default_factory=dict)
    kinds: dict[int, str] = field(default_factory=dict)  # of sets: nodes, cells
    case_sets: dict[int, str] = field(default_factory=dict)
    cards: list[_Card] = field(default_factory=list)
    _pending: int = 0  # set of the case control whose line continues

    def note_name(self, comment: re.Match[str]) -> None:
        """Note the name that a comment gives to a set or a property."""
        is_set, number_of = comment[1] == "SET", int(comment[2][:18])
        self.names["set" if is_set else "property", number_of] = comment[4]
        if is_set:
            self.kinds[number_of] = {"1": "nodes", "2": "cells"}.get(comment[3], "")

    def read_case(self, line: str) -> None:
        """Read a line of the case control, which may be a set."""
        if match := _CASE_SET.match(line.strip()):
            self._pending = int(match[1][:18])
            self.case_sets[self._pending] = match[2]
        elif self._pending:
            self.case_sets[self._pending] += f" {line.strip()}"
        self._pending = self._pending if line.endswith(",") else 0


def read_bdf(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return arrays of grid points, elements, properties and sets; ``ignored`` are other cards."""
    deck = _deck(path)
    body = _Body(deck)
    for card in deck.cards:
        body.read(card)
    arrays = element_arrays(body.tags, body.points(), body.blocks, body.sets(), _KINDS)
    return {"ignored": sorted(body.ignored)}, arrays


class _Body:
    """Grid points, elements and sets of the cards that are read."""

    def __init__(self, deck: _Deck) -> None:
        self._deck = deck
        self.tags: list[int] = []
        self.blocks = Blocks()
        self.ignored = set[str]()
        self._given: list[list[float]] = []
        self._systems: dict[int, CoordinateCard] = {}
        self._own_systems: list[tuple[str, str]] = []  # of the grid points, with their places
        self._default = ""
        self._properties: dict[int, list[int]] = {}
        self._listed: dict[int, tuple[str, list[int]]] = {}

    def read(self, card: _Card) -> None:
        """Read a card; raise ``Fault`` if it is damaged or of an element that is not read."""
        if reader := self._READERS.get(card.name):
            reader(self, card)
        elif card.name not in _GENERAL:
            self.ignored.add(card.name)

    def _read_point(self, card: _Card) -> None:
        self._own_systems.append((card.place, [*card.fields, "", ""][1]))
        self.tags.append(whole_number((card.fields or [""])[0], card.place))
        self._given.append([number(text, card.place) for text in (card.fields + ["0"] * 5)[2:5]])

    def _read_system(self, card: _Card) -> None:
        tag = whole_number((card.fields or [""])[0], card.place)
        self._systems[tag] = CoordinateCard(card.place, card.name, card.fields)

    def _read_defaults(self, card: _Card) -> None:
        self._default = [*card.fields, "", ""][1]

    def _read_solid(self, card: _Card) -> None:
        tag, owner, *nodes = _element(card, 22)
        nodes = [node for node in nodes if node]
        if len(nodes) not in _SOLIDS[card.name]:
            raise Fault(f"{card.place}: element {tag} has {len(nodes)} nodes", f"Elements are {_KINDS}.")
        self.blocks.add(tag, [nodes[i] for i in _BRICK] if len(nodes) == 20 else nodes)
        self._properties.setdefault(owner, []).append(tag)

    def _read_facet(self, card: _Card) -> None:
        tag, owner, *nodes = _element(card, 2 + _FLAT[card.name])
        self.blocks.add_facet(tag, vertices_of(nodes), _name(self._deck, "property", owner))

    def _refuse(self, card: _Card) -> None:
        raise Fault(f"{card.place}: elements {card.name} are not supported", f"Elements are {_KINDS}.")

    def _read_set(self, card: _Card) -> None:
        kind, first = "", 1
        if card.name != "SET1":
            given = card.fields[1].strip().upper() if len(card.fields) > 1 else ""
            kind, first = {"GRID": "nodes", "POINT": "nodes", "ELEM": "cells"}.get(given, "other"), 2
        tag = whole_number(card.fields[0] if card.fields else "", card.place)
        if kind != "other":
            members = _members([text for text in card.fields[first:] if text.strip() != "LIST"], card.place)
            self._listed.setdefault(tag, (kind, []))[1].extend(members)

    def points(self) -> list[list[float]]:
        """Return the positions of the grid points in space; raise ``Fault`` if a system is missing."""
        frames = Frames(self._systems)
        return [
            frames.position(point, system if system.strip() else self._default, place)
            for point, (place, system) in zip(self._given, self._own_systems, strict=True)
        ]

    def sets(self) -> dict[str, list[int]]:
        """Return properties and sets by kind and name."""
        named = {f"cells:{_name(self._deck, 'property', tag)}": members for tag, members in self._properties.items()}
        nodes = set(self.tags)
        elements = {tag for numbers, _ in self.blocks.solids.values() for tag in numbers} | self.blocks.others.keys()
        self._list_case_sets(nodes, elements)
        for tag, (kind, members) in self._listed.items():
            is_of_cells = not all_in(members, nodes) and all_in(members, elements)
            kind = kind or self._deck.kinds.get(tag, "") or ("cells" if is_of_cells else "nodes")
            named[f"{kind}:{_name(self._deck, 'set', tag)}"] = members
        return named

    def _list_case_sets(self, nodes: set[int], elements: set[int]) -> None:
        """List the sets of requests of output that have nodes or elements; others may be ALL, or other numbers."""
        for tag, text in self._deck.case_sets.items():
            with contextlib.suppress(Fault):
                members = _members(re.split(r"[,\s]+", text), f"SET {tag}")
                if all_in(members, nodes) or all_in(members, elements):
                    self._listed.setdefault(tag, ("", members))

    _READERS: ClassVar[dict[str, Callable[["_Body", _Card], None]]] = {
        "GRID": _read_point,
        "GRDSET": _read_defaults,
        **dict.fromkeys((*KINDS, *BY_NODES), _read_system),
        **dict.fromkeys(_SOLIDS, _read_solid),
        **dict.fromkeys(_FLAT, _read_facet),
        **dict.fromkeys(("CPENTA", "CPYRAM"), _refuse),
        **dict.fromkeys(("SET1", "SET3", "SET"), _read_set),
    }


def _element(card: _Card, most: int) -> list[int]:
    """Return the number of an element, its property (by default of the same number) and its nodes."""
    fields = card.fields[:most]
    if len(fields) > 1 and not fields[1].strip():  # as meshio writes it
        fields = [fields[0], fields[0], *fields[2:]]
    entries = whole_numbers(fields, card.place)
    if len(entries) < 2:
        raise Fault(f"{card.place}: an element has {len(entries)} numbers", "Is the file complete?")
    return entries


def _name(deck: _Deck, what: str, tag: int) -> str:
    return deck.names.get((what, tag), f"{what}-{tag}")


def _deck(path: Path) -> _Deck:
    """Return the cards of a file, without what comes before ``BEGIN BULK`` but the sets there."""
    deck, lines = _Deck(), list(lines_of(path, Inclusions(path.parent), ()))
    begin = next((line.place for line in lines if _BEGIN.match(line.text)), "")
    is_bulk = not begin
    for place, raw in lines:
        if match := _NAME.match(raw):
            deck.note_name(match)
        line = raw.split("$")[0].rstrip()
        if line and not is_bulk:
            deck.read_case(line)
            is_bulk = line.strip().upper().startswith("BEGIN")
        elif line:
            _add_line(deck, line, place)
            if deck.cards and deck.cards[-1].name == "ENDDATA":
                break
    if not deck.cards:
        raise Fault("has no bulk data", "Is it an input file of Nastran?")
    if begin and deck.cards[-1].name != "ENDDATA":
        raise Fault(f"{begin}: BEGIN BULK has no ENDDATA", "Is the file complete?")
    return deck


def lines_of(path: Path, inclusions: Inclusions, above: tuple[Path, ...]) -> Iterator[FileLine]:
    """Yield the lines of a file with the lines of the files that it includes.

    Args:
        above: the files that include this one.

    Raises:
        Fault: a file is missing, includes itself, or is not text; or too much is included.
    """
    command, inner = "", (*above, path.resolve())
    for row, line in enumerate(text_of(path, above).splitlines(), 1):
        place = place_in(above, path, f"line {row}")
        if not command and not _INCLUDE.match(line):
            yield FileLine(place, line)
            continue
        command += line.split("$")[0].strip()
        if len(command) > _LONGEST_COMMAND:
            raise Fault(f"{place}: an INCLUDE has no end", "Close its quotation mark.")
        if command.count("'") == 1 or command.count('"') == 1:  # a name may be continued
            continue
        name = command[len("INCLUDE") :].strip().strip("'\"=").strip()
        yield from lines_of(inclusions.find(name, inner, place), inclusions, inner)
        command = ""


def _add_line(deck: _Deck, line: str, place: str) -> None:
    """Add the fields of a line to the last card, or begin one."""
    line = line.expandtabs(8)
    if "," in line:
        head, *fields = line.split(",")
        fields = fields[:8] if len(fields) > 8 else fields
    else:
        head, width = line[:8], 16 if "*" in line[:8] else 8
        fields = [line[at : at + width] for at in range(8, min(len(line), 72), width)]
        fields += [""] * ((64 // width if len(line) > 8 else 0) - len(fields))
    name = head.strip().rstrip("*_").upper()  # meshio writes CTETRA_ with 10 nodes
    if not name or name.startswith("+") or head.lstrip().startswith("*"):
        if not deck.cards:
            raise Fault(f"{place}: continues nothing", "Is it an input file of Nastran?")
        last = deck.cards[-1]
        last.fields += fields
        return
    deck.cards.append(_Card(place, name.split()[0], fields))


def _members(texts: list[str], place: str) -> list[int]:
    """Return numbers of a list; ``THRU`` between two of them is a range."""
    words = [text.strip().upper() for text in texts if text.strip()]
    members: list[int] = []
    for at, word in enumerate(words):
        if word == "THRU":
            continue
        entry = whole_number(word, place)
        if at and words[at - 1] == "THRU" and members:
            if not 0 <= entry - members[-1] <= 10**8:
                raise Fault(f"{place}: the range to {entry} is not valid")
            members += range(members[-1] + 1, entry + 1)
        else:
            members.append(entry)
    return members
