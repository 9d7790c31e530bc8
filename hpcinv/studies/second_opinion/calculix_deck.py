"""Whole decks for CalculiX and Abaqus: mesh, sets, laws, what is held, loads, one static step."""

from __future__ import annotations

import csv
import io
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from hpcinv.base.files.atomic import write_output
from hpcinv.errors import JobError, OutputError
from hpcinv.formats.cards import abaqus
from hpcinv.formats.cards.card import Values
from hpcinv.formats.inp import number
from hpcinv.formats.readers.elements import elements_of, faces_of
from hpcinv.geometry.workshop.cell_mesh import write_cells
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.physics.effects.elastic_foundation import ElasticFoundation
from hpcinv.physics.effects.thermal_expansion import ThermalExpansion
from hpcinv.physics.materials import MaterialLaw
from hpcinv.studies.second_opinion.abaqus_fibres import orientation_lines, orientation_of
from hpcinv.studies.second_opinion.calculix_couplings import MOMENT_NOTE, coupling_lines, remote_forces
from hpcinv.studies.second_opinion.calculix_frames import Frames
from hpcinv.studies.second_opinion.calculix_heat import (
    add_expansion,
    expansion_lines,
    first_temperature,
    last_temperature,
)
from hpcinv.studies.second_opinion.calculix_springs import spring_lines
from hpcinv.studies.second_opinion.calculix_steps import check_steps, later_path, without_earlier_loads
from hpcinv.studies.second_opinion.calculix_units import coarse_residual
from hpcinv.studies.second_opinion.loaded_body import WRITERS, Ability, LoadedBody, Writers, add_foundation
from hpcinv.studies.second_opinion.units import Units

type Program = Literal["calculix", "abaqus"]
ABILITIES: tuple[Ability, ...] = ("slides", "remote", "shell", "vertices")
LOADS: Writers = {**WRITERS, ElasticFoundation: add_foundation, ThermalExpansion: add_expansion}
"""What is written; every other effect is refused by its name."""
CELLS, NODES = "HPCINV_CELLS", "HPCINV_NODES"
"""sets of all cells and of all nodes"""
_ELEMENT = "*ELEMENT, TYPE="
_PER_LINE = 16
LEAST_COMPLIANCE = 1e-10
"""Least compliance of a card that CalculiX 2.20 does not take for 0: between 0.95e-10 and 1.07e-10 by its results."""
_RESIDUAL = 1e-6
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


def write_deck(path: Path, body: LoadedBody, units: Units, program: Program = "calculix") -> Deck:
    """Write a deck, and next to it NAME-expected.csv with the place of each node in both bodies.

    Further steps of the body have NAME-expected-2.csv and so on.

    Args:
        units: of its numbers.
        program: that reads it.

    Raises:
        OutputError: it cannot be written, or a law has no card, or the program has no elements for it.
    """
    if program == "calculix" and any(law.is_incompressible for law in body.laws.values()):
        raise OutputError("material: CalculiX has no elements for incompressible bodies", "Give kappa a number.")
    if program == "abaqus" and body.expansion:
        text = "effects: thermal expansion has no tested counterpart in Abaqus: its energy may be per unheated volume"
        raise OutputError(text, "Export a job without it.")
    with tempfile.TemporaryDirectory() as directory:
        plain = Path(directory) / "mesh.inp"
        mesh = write_cells(plain, body.rest, None, 1.0, units.length)
        text = plain.read_text("utf-8")
    elements = elements_of(mesh)
    nodes = np.unique(elements)
    element = text.partition(_ELEMENT)[2].partition("\n")[0]
    if program == "abaqus" and body.is_mixed:
        text = text.replace(f"{_ELEMENT}{element}\n", f"{_ELEMENT}{element}H\n", 1)
        element = f"{element}H"
    deck = Deck(nodes, mesh.node_tags[nodes], element)
    if program == "calculix":
        body.notes += [f"{remote.place}: {MOMENT_NOTE}" for remote in body.remotes if remote.moment.any()]
    check_steps(body)
    posed = _Posed(body, mesh, elements, deck, Frames(body), units, program)
    heed_limits(body, units, program)
    lines = [text, *_model(posed), *_step(posed)]
    for later in body.steps:
        lines += _step(replace(posed, body=later), is_first=False)
    advice = "Is the directory there, and writable?"
    write_output(path, "".join(lines).encode(), advice)
    table = expected_path(path)
    write_output(table, expected_table(body, deck, units).encode(), advice)
    for number_of, later in enumerate(body.steps, 2):
        write_output(later_path(table, number_of), expected_table(later, deck, units).encode(), advice)
    return deck


def expected_path(deck: Path) -> Path:
    """Return the file with the places of the nodes that is written with a deck."""
    return deck.with_name(f"{deck.stem}-expected.csv")


@dataclass(frozen=True)
class _Posed:
    """A body as a deck has it.

    Attributes:
        elements: nodes (rows) of the elements, in their order.
    """

    body: LoadedBody
    mesh: MeshSource
    elements: Ints
    deck: Deck
    frames: Frames
    units: Units
    program: Program

    @property
    def first_node(self) -> int:
        """Number of the first node that is not of the mesh."""
        return int(self.mesh.node_tags.max()) + 1


def _model(posed: _Posed) -> Iterator[str]:
    """Yield sets, materials, sections, what springs and couplings are, and what is fixed."""
    body, mesh, units = posed.body, posed.mesh, posed.units
    yield f"*NSET, NSET={NODES}\n"
    yield from set_rows(posed.deck.tags.tolist())
    yield f"*ELSET, ELSET={CELLS}\n"
    yield from set_rows(mesh.cell_tags.tolist())
    for region, law in body.laws.items():
        yield from _material(body, region, law, units)
    yield from posed.frames.lines(mesh.node_tags, posed.deck.nodes)
    yield from coupling_lines(body, posed.first_node, units)
    yield from spring_lines(body, mesh, posed.frames, posed.first_node + len(body.remotes), units)
    yield from first_temperature(body, NODES)
    yield from _held(posed, moved=False)


def _material(body: LoadedBody, region: str, law: MaterialLaw, units: Units) -> Iterator[str]:
    """Yield the material of a region, or of the whole body, and its section."""
    name = region or "BODY"
    yield from orientation_lines(body, law, name)
    yield card_of(law, name, units)
    if body.density:
        yield f"*DENSITY\n{number(body.density_of(region) / units.density)}\n"
    yield from expansion_lines(body)
    axes = orientation_of(law, name)
    yield f"*SOLID SECTION, ELSET={region or CELLS}, MATERIAL={name}{f', ORIENTATION={axes}' if axes else ''}\n"


def card_of(law: MaterialLaw, name: str, units: Units) -> str:
    """Return the card of a law; raise ``OutputError`` if it has none."""
    try:
        return abaqus.write(Values(law, abaqus.PROGRAM, units.stress), name)
    except JobError as error:
        raise OutputError(f"material: {error.problems[0]}", "Take a law that both programs have.") from None


def heed_limits(body: LoadedBody, units: Units, program: Program) -> None:
    """Raise ``OutputError`` if CalculiX would take a compliance of a law for 0; note if it would take loads for it."""
    if program != "calculix":
        return
    body.notes += [note] if (note := coarse_residual(body, units)) else []
    for region, law in body.laws.items():
        lines = (line for line in card_of(law, region, units).splitlines() if line[:1] != "*")
        first, *others = (abs(float(word)) for line in lines for word in line.split(","))
        if first > 1 and any(0 < value < LEAST_COMPLIANCE for value in others):  # stiffnesses come first
            raise OutputError(
                f"material: CalculiX takes compliances of a law below {LEAST_COMPLIANCE:g} for 0, and then another"
                " compressibility",
                "Give a smaller unit of length, such as --unit mm, or a larger --force-unit.",
            )


def _held(posed: _Posed, *, moved: bool) -> Iterator[str]:
    """Yield what is held and moves, or does not move."""
    tags, used, frames = posed.mesh.node_tags, posed.deck.nodes, posed.frames
    lines = list[str]()
    for held in posed.body.held:
        if bool(held.values.any()) is not moved:
            continue
        axis = held.axis + 1
        is_own = np.isin(held.nodes, frames.own)
        if held.region and not moved and not is_own.any():
            lines.append(f"{held.region}, {axis}, {axis}\n")
            continue
        is_said = np.isin(held.nodes, used) & ~is_own
        for tag, value in zip(tags[held.nodes[is_said]], held.values[is_said].tolist(), strict=True):
            lines.append(f"{tag}, {axis}, {axis}, {number(value / posed.units.length)}\n")
    lines += frames.held(tags, used, posed.units, moved=moved)
    if lines:
        yield from ("*BOUNDARY\n", *lines)


def _step(posed: _Posed, *, is_first: bool = True) -> Iterator[str]:
    """Yield a step, with what is moved, loads and output."""
    body = posed.body
    yield from step_head(posed.program)
    yield from () if is_first else without_earlier_loads()
    yield from _held(posed, moved=True)
    yield from last_temperature(body, NODES)
    yield from weight_lines(body, posed.units)
    for group, pressure in body.pressures:
        yield "*DLOAD\n"
        for cell, face in faces_of(posed.mesh, group, posed.elements):
            yield f"{posed.mesh.cell_tags[cell]}, P{face + 1}, {number(pressure / posed.units.stress)}\n"
    on_references = remote_forces(body, posed.program, posed.first_node, posed.units)
    if forces := [*on_references, *nodal_forces(posed.frames.local(body.forces), posed.deck, posed.units)]:
        yield from ("*CLOAD\n", *forces)
    yield from output_lines()


def step_head(program: Program) -> Iterator[str]:
    """Yield the begin of a step."""
    yield "*STEP, NLGEOM, INC=1000\n*STATIC\n0.1, 1., 1e-6, 1.\n"
    if program == "calculix":
        yield f"*CONTROLS, PARAMETERS=FIELD\n{_RESIDUAL!r}, {_RESIDUAL!r}, 0.01, , 0.02, {_RESIDUAL!r}\n"


def weight_lines(body: LoadedBody, units: Units) -> Iterator[str]:
    """Yield gravity, if there is any."""
    if (size := float(np.linalg.norm(body.acceleration))) and body.density:
        direction = ", ".join(number(float(g) / size) for g in body.acceleration)
        yield f"*DLOAD\n{CELLS}, GRAV, {number(size / units.length)}, {direction}\n"


def nodal_forces(forces: Floats, deck: Deck, units: Units) -> Iterator[str]:
    """Yield lines of forces (n, 3), N, at the body's nodes that are not zero."""
    for tag, force in zip(deck.tags.tolist(), (forces[deck.nodes] / units.force).tolist(), strict=True):
        yield from (f"{tag}, {axis}, {number(component)}\n" for axis, component in enumerate(force, 1) if component)


def output_lines() -> Iterator[str]:
    """Yield requests of displacements, and the end of the step."""
    yield f"*NODE FILE\nU\n*NODE PRINT, NSET={NODES}, FREQUENCY=10000, GLOBAL=YES\nU\n*END STEP\n"


def expected_table(body: LoadedBody, deck: Deck, units: Units) -> str:
    """Return a table (CSV) of the places of each node: at rest, and loaded."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["node", "X", "Y", "Z", "x", "y", "z"])
    places = np.hstack([body.rest.points[deck.nodes], body.loaded[deck.nodes]]) / units.length
    writer.writerows([tag, *map(repr, row)] for tag, row in zip(deck.tags.tolist(), places.tolist(), strict=True))
    return text.getvalue()


def set_rows(entries: Sequence[int]) -> Iterator[str]:
    """Yield lines of a set."""
    for start in range(0, len(entries), _PER_LINE):
        yield f"{', '.join(map(str, entries[start : start + _PER_LINE]))}\n"
