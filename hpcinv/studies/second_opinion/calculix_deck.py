"""Whole decks for CalculiX and Abaqus: mesh, sets, laws, what is held, loads, one static step."""

from __future__ import annotations

import csv
import io
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hpcinv.base.files.atomic import write_output
from hpcinv.errors import JobError, OutputError
from hpcinv.formats.cards import abaqus
from hpcinv.formats.cards.card import Values
from hpcinv.formats.inp import number
from hpcinv.formats.readers.elements import elements_of, faces_of
from hpcinv.geometry.workshop.cell_mesh import write_cells
from hpcinv.mesh.source import Ints, MeshSource
from hpcinv.physics.materials import MaterialLaw
from hpcinv.studies.second_opinion.loaded_body import Held, LoadedBody

CELLS, NODES = "HPCINV_CELLS", "HPCINV_NODES"
"""sets of all cells and of all nodes"""
_PER_LINE = 16
_RESIDUAL = 1e-8
"""Largest residual force, relative to the mean one. The program ends there. Raised, its body differs by more."""


@dataclass(frozen=True)
class Deck:
    """A deck of a body.

    Attributes:
        nodes: rows of the body's nodes that it has; hexahedra of degree 2 have 20.
        tags: their numbers in the deck.
        element: its type.
    """

    nodes: Ints
    tags: Ints
    element: str


def write_deck(path: Path, body: LoadedBody, unit: float) -> Deck:
    """Write a deck, and next to it NAME-expected.csv with the place of each node in both bodies.

    Forces are in N, so that stresses are in N per squared unit of length, and densities in N s² per its fourth power.

    Args:
        unit: of length, m.

    Raises:
        OutputError: it cannot be written, or a law has no card.
    """
    with tempfile.TemporaryDirectory() as directory:
        plain = Path(directory) / "mesh.inp"
        mesh = write_cells(plain, body.rest, None, 1.0, unit)
        text = plain.read_text("utf-8")
    elements = elements_of(mesh)
    nodes = np.unique(elements)
    deck = Deck(nodes, mesh.node_tags[nodes], text.partition("*ELEMENT, TYPE=")[2].partition("\n")[0])
    lines = [text, *_model(body, mesh, deck, unit), *_step(body, mesh, elements, deck, unit)]
    advice = "Is the directory there, and writable?"
    write_output(path, "".join(lines).encode(), advice)
    write_output(expected_path(path), expected_table(body, deck, unit).encode(), advice)
    return deck


def expected_path(deck: Path) -> Path:
    """Return the file with the places of the nodes that is written with a deck."""
    return deck.with_name(f"{deck.stem}-expected.csv")


def _model(body: LoadedBody, mesh: MeshSource, deck: Deck, unit: float) -> Iterator[str]:
    """Yield sets, materials, sections, and what is fixed."""
    yield f"*NSET, NSET={NODES}\n"
    yield from _rows(deck.tags.tolist())
    yield f"*ELSET, ELSET={CELLS}\n"
    yield from _rows(mesh.cell_tags.tolist())
    for region, law in body.laws.items():
        yield _card(law, region or "BODY", unit)
        if body.density:
            yield f"*DENSITY\n{number(body.density * unit**4)}\n"
        yield f"*SOLID SECTION, ELSET={region or CELLS}, MATERIAL={region or 'BODY'}\n"
    yield from _held((held for held in body.held if not held.values.any()), mesh, deck, unit)


def _card(law: MaterialLaw, name: str, unit: float) -> str:
    try:
        return abaqus.write(Values(law, abaqus.PROGRAM, unit**-2), name)
    except JobError as error:
        raise OutputError(f"material: {error.problems[0]}", "Take a law that both programs have.") from None


def _held(parts: Iterable[Held], mesh: MeshSource, deck: Deck, unit: float) -> Iterator[str]:
    head = "*BOUNDARY\n"
    for held in parts:
        is_there = np.isin(held.nodes, deck.nodes)
        axis = held.axis + 1
        for tag, value in zip(mesh.node_tags[held.nodes[is_there]], held.values[is_there].tolist(), strict=True):
            yield f"{head}{tag}, {axis}, {axis}, {number(value / unit)}\n"
            head = ""


def _step(body: LoadedBody, mesh: MeshSource, elements: Ints, deck: Deck, unit: float) -> Iterator[str]:
    """Yield the step, with what is moved, loads and output."""
    yield "*STEP, NLGEOM, INC=1000\n*STATIC\n0.1, 1., 1e-6, 1.\n"
    yield f"*CONTROLS, PARAMETERS=FIELD\n{_RESIDUAL!r}, {_RESIDUAL!r}, 0.01, , 0.02, {_RESIDUAL!r}\n"
    yield from _held((held for held in body.held if held.values.any()), mesh, deck, unit)
    if (size := float(np.linalg.norm(body.acceleration))) and body.density:
        direction = ", ".join(number(float(g) / size) for g in body.acceleration)
        yield f"*DLOAD\n{CELLS}, GRAV, {number(size / unit)}, {direction}\n"
    for group, pressure in body.pressures:
        yield "*DLOAD\n"
        for cell, face in faces_of(mesh, group, elements):
            yield f"{mesh.cell_tags[cell]}, P{face + 1}, {number(pressure * unit**2)}\n"
    if body.forces.any():
        yield "*CLOAD\n"
        for tag, force in zip(deck.tags.tolist(), body.forces[deck.nodes].tolist(), strict=True):
            yield from (f"{tag}, {axis}, {number(component)}\n" for axis, component in enumerate(force, 1) if component)
    yield f"*NODE FILE\nU\n*NODE PRINT, NSET={NODES}, FREQUENCY=10000\nU\n*END STEP\n"


def expected_table(body: LoadedBody, deck: Deck, unit: float) -> str:
    """Return a table (CSV) of the places of each node in a unit (m): at rest, and loaded."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["node", "X", "Y", "Z", "x", "y", "z"])
    places = np.hstack([body.rest.points[deck.nodes], body.loaded[deck.nodes]]) / unit
    writer.writerows([tag, *map(repr, row)] for tag, row in zip(deck.tags.tolist(), places.tolist(), strict=True))
    return text.getvalue()


def _rows(entries: Sequence[int]) -> Iterator[str]:
    for start in range(0, len(entries), _PER_LINE):
        yield f"{', '.join(map(str, entries[start : start + _PER_LINE]))}\n"
