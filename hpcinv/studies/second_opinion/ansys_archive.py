"""Whole decks for Ansys Mechanical APDL: mesh, components, laws, what is held, loads, one static step.

Sources: *Ansys Mechanical APDL Command Reference*, ACEL, CNVTOL, D, F, NLGEOM, SFE, TB; *Element Reference*, SOLID185,
SOLID186, SOLID187 and SOLID285.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hpcinv.base.files.atomic import write_output
from hpcinv.base.reading.archive_conditions import BRICK, COLLAPSED, TETRAHEDRON
from hpcinv.errors import JobError, OutputError
from hpcinv.formats.cards import ansys
from hpcinv.formats.cards.card import Values
from hpcinv.formats.cdb import mesh_lines
from hpcinv.formats.inp import number
from hpcinv.formats.readers.elements import elements_of, faces_of
from hpcinv.geometry.workshop.cell_mesh import write_cells
from hpcinv.job.rules import wants_pressure
from hpcinv.mesh.source import Ints, MeshSource
from hpcinv.physics.materials import MaterialLaw
from hpcinv.studies.second_opinion.ansys_slides import slide_lines
from hpcinv.studies.second_opinion.calculix_deck import Deck, expected_path, expected_table
from hpcinv.studies.second_opinion.loaded_body import Ability, Held, LoadedBody
from hpcinv.studies.second_opinion.regions import group_of
from hpcinv.studies.second_opinion.uniform_values import is_uniform
from hpcinv.studies.second_opinion.units import Units

ABILITIES: tuple[Ability, ...] = ("slides",)
_UNITS = {Units(1.0): "SI", Units(1e-3): "MPA"}
"""systems of units that Ansys names"""
_RESIDUAL = 1e-8
"""Residual force over the applied one at which the program ends a substep. Raised, its body differs by more."""
_AS_BRICK = [0, 1, 2, 2, 3, 3, 3, 3]
"""nodes of a tetrahedron in the places of a brick's"""


@dataclass(frozen=True)
class _Element:
    """A type of elements.

    Attributes:
        options: values of its KEYOPT by their numbers.
        faces: Ansys' number of each face by its place in the order of Abaqus.
        nodes: places of the nodes that Ansys lists.
    """

    name: str
    options: dict[int, int]
    faces: dict[int, int]
    nodes: list[int]


def write_archive(path: Path, body: LoadedBody, units: Units) -> Deck:
    """Write a deck, and next to it NAME-expected.csv with the place of each node in both bodies.

    Args:
        units: of its numbers.

    Raises:
        OutputError: it cannot be written, or a law has no card.
    """
    with tempfile.TemporaryDirectory() as directory:
        mesh = write_cells(Path(directory) / "mesh.cdb", body.rest, None, 1.0, units.length)
    elements = elements_of(mesh)
    nodes = np.unique(elements)
    element = _element(mesh, elements.shape[1], is_mixed=wants_pressure(body.laws))
    deck = Deck(nodes, mesh.node_tags[nodes], element.name)
    lines = [*_model(body, mesh, elements, element, units), *_step(body, mesh, elements, element, deck, units)]
    lines += _output(path)
    advice = "Is the directory there, and writable?"
    write_output(path, "".join(lines).encode("latin-1", "replace"), advice)
    write_output(expected_path(path), expected_table(body, deck, units).encode(), advice)
    return deck


def _element(mesh: MeshSource, count: int, *, is_mixed: bool) -> _Element:
    """Return the type for elements of a number of nodes; pressures are unknowns (KEYOPT(6)) if the law needs it."""
    mixed = {6: 1} if is_mixed else {}
    own = list(range(count))
    if mesh.kind == "hexahedron":
        full = {} if is_mixed or count == 8 else {2: 1}  # all integration points of SOLID186
        return _Element("SOLID185" if count == 8 else "SOLID186", full | mixed, _places(BRICK), own)
    if count == 10:
        return _Element("SOLID187", mixed, _places(TETRAHEDRON), own)
    if is_mixed:  # has a pressure at each node
        return _Element("SOLID285", {}, _places(TETRAHEDRON), own)
    return _Element("SOLID185", {}, _places(COLLAPSED), _AS_BRICK)


def _places(numbers: dict[int, int]) -> dict[int, int]:
    return {place: face for face, place in numbers.items()}


def _model(body: LoadedBody, mesh: MeshSource, elements: Ints, element: _Element, units: Units) -> Iterator[str]:
    """Yield mesh, components and materials."""
    yield f"! {body.name}: forces in {number(units.force)} N, lengths in {number(units.length)} m, seconds\n"
    if units in _UNITS:
        yield f"/UNITS,{_UNITS[units]}\n"
    yield f"/PREP7\nET,1,{element.name.removeprefix('SOLID')}\n"
    yield from (f"KEYOPT,1,{option},{value}\n" for option, value in element.options.items())
    materials = np.ones(len(elements), dtype=np.int64)
    cards = list[str]()
    for material, (region, law) in enumerate(body.laws.items(), 1):
        if region:
            materials[group_of(mesh, region, 3).members] = material
        cards.append(_card(law, region or "BODY", material, units))
        if body.density:
            cards.append(f"MP,DENS,{material},{number(body.density_of(region) / units.density)}\n")
    listed = mesh.node_tags[elements[:, element.nodes]]
    yield from mesh_lines(mesh, mesh.points / units.length, elements, listed, materials)
    yield from cards
    yield "FINISH\n"


def _card(law: MaterialLaw, name: str, material: int, units: Units) -> str:
    try:
        return ansys.write(Values(law, ansys.PROGRAM, units.stress), name, material)
    except JobError as error:
        raise OutputError(f"material: {error.problems[0]}", "Take a law that both programs have.") from None


def _step(
    body: LoadedBody, mesh: MeshSource, elements: Ints, element: _Element, deck: Deck, units: Units
) -> Iterator[str]:
    """Yield the step, with supports and loads; ten substeps lead to the full load."""
    yield "/SOLU\nANTYPE,STATIC\nNLGEOM,ON\nNROPT,UNSYM\nKBC,0\nTIME,1\nAUTOTS,ON\nNSUBST,10,10000,10\n"
    yield f"CNVTOL,F,,{_RESIDUAL!r}\nOUTRES,ALL,LAST\n"
    for held in body.held:
        yield from _held(held, mesh, deck, units)
    yield from slide_lines(body, mesh, deck.nodes)
    if body.density and body.acceleration.any():  # of the frame: the body is pulled the other way
        yield f"ACEL,{','.join(number(0.0 - float(part) / units.length) for part in body.acceleration)}\n"
    for group, pressure in body.pressures:
        for cell, face in faces_of(mesh, group, elements):
            yield f"SFE,{mesh.cell_tags[cell]},{element.faces[face]},PRES,0,{number(pressure / units.stress)}\n"
    if body.forces.any():
        for tag, force in zip(deck.tags.tolist(), (body.forces[deck.nodes] / units.force).tolist(), strict=True):
            yield from (f"F,{tag},F{axis},{number(part)}\n" for axis, part in zip("XYZ", force, strict=True) if part)
    yield "ALLSEL,ALL\nSOLVE\nFINISH\n"


def _held(held: Held, mesh: MeshSource, deck: Deck, units: Units) -> Iterator[str]:
    """Yield a displacement: of a component if it is uniform and the component has just these nodes, else of each."""
    label, name = f"U{'XYZ'[held.axis]}", held.region.replace("|", "_")
    is_region = all(group.dim == 2 for group in mesh.groups if group.name == name)
    is_there = np.isin(held.nodes, deck.nodes)
    values = held.values[is_there] / units.length
    if is_region and is_uniform(values):
        yield f"D,{name},{label},{number(float(values.mean()))}\n"
        return
    for tag, value in zip(mesh.node_tags[held.nodes[is_there]].tolist(), values.tolist(), strict=True):
        yield f"D,{tag},{label},{number(value)}\n"


def _output(path: Path) -> Iterator[str]:
    """Yield the list of displacements that goes to NAME-displacement.txt."""
    yield "/POST1\nSET,LAST\n/GRAPHICS,FULL\n/FORMAT,10,E,24,15,1000000\n"
    yield f"/OUTPUT,{path.stem}-displacement,txt\nPRNSOL,U,COMP\n/OUTPUT\nFINISH\n"
