"""Whole models for FEBio (format 4.0): mesh, sets, laws, what is held, loads, one static step."""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.files.atomic import write_output
from hpcinv.errors import JobError, OutputError
from hpcinv.formats.cards import febio
from hpcinv.formats.cards.card import Values
from hpcinv.formats.feb import HEAD, mesh_lines
from hpcinv.formats.readers.elements import elements_of
from hpcinv.geometry.workshop.cell_mesh import write_cells
from hpcinv.job.rules import wants_pressure
from hpcinv.job.vocabulary import AXES
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.physics.effects.elastic_foundation import ElasticFoundation
from hpcinv.physics.effects.gravity import Gravity
from hpcinv.physics.effects.traction import Traction
from hpcinv.studies.second_opinion.calculix_deck import Deck, expected_path, expected_table
from hpcinv.studies.second_opinion.febio_fibres import FibreMaps
from hpcinv.studies.second_opinion.febio_rigid import rigid_conditions, rigid_loads, rigid_materials
from hpcinv.studies.second_opinion.febio_springs import springs_of
from hpcinv.studies.second_opinion.febio_ties import Ties
from hpcinv.studies.second_opinion.loaded_body import (
    WRITERS,
    Ability,
    Held,
    LoadedBody,
    Writers,
    add_foundation,
)
from hpcinv.studies.second_opinion.regions import group_of
from hpcinv.studies.second_opinion.uniform_values import is_uniform
from hpcinv.studies.second_opinion.units import Units

ABILITIES: tuple[Ability, ...] = ("slides", "remote", "vertices", "fibre fields")
_BODY = "BODY"
"""name of the part and of the material of a body with one law"""
_CURVE = """<LoadData>
<load_controller id="1" name="load" type="loadcurve">
<interpolate>LINEAR</interpolate><extend>CONSTANT</extend>
<points><pt>0,0</pt><pt>1,1</pt></points>
</load_controller>
</LoadData>"""
_CONTROL = """<Control>
<analysis>STATIC</analysis>
<time_steps>10</time_steps>
<step_size>0.1</step_size>
<time_stepper type="default"><max_retries>10</max_retries><dtmin>1e-6</dtmin><dtmax>0.1</dtmax></time_stepper>
<solver type="solid">
<symmetric_stiffness>non-symmetric</symmetric_stiffness>
<dtol>1e-8</dtol><etol>1e-12</etol><rtol>0</rtol>
</solver>
</Control>"""
"""Ten steps to the full load, with the stiffness of follower pressures. Raised tolerances let FEBio's body differ."""
_UNITS = {Units(1.0): "SI", Units(1e-3): "mm-N-s"}
"""systems of units that FEBio names"""


def write_model(path: Path, body: LoadedBody, units: Units) -> Deck:
    """Write a model, and next to it NAME-expected.csv with the place of each node in both bodies.

    Args:
        body: with the loads of `LOADS`.
        units: of its numbers.

    Raises:
        OutputError: it cannot be written, or a law has no card.
    """
    with tempfile.TemporaryDirectory() as directory:
        complete = replace(body.rest, nodes_per_cell=body.rest.cells.shape[1])
        mesh = write_cells(Path(directory) / "mesh.feb", complete, None, 1.0, units.length)
    elements = elements_of(mesh, has_27=True)
    parts = {
        region or _BODY: group_of(mesh, region, 3).members if region else np.arange(len(mesh.cells))
        for region in body.laws
    }
    nodes = np.unique(elements)
    _refuse_conflicts(body)
    ties = Ties(body)
    held = [*body.held, *_determined(ties)]
    maps = FibreMaps(body, parts, elements)
    cards = list(_materials(body, maps, units))
    first_rigid = len(cards) + 1
    springs = springs_of(body, mesh, ties, int(mesh.node_tags.max()) + 1, units)
    system = f"<units>{_UNITS[units]}</units>" if units in _UNITS else ""
    sets = [*maps.sets(mesh.cell_tags), *_node_sets(held, mesh, nodes), *springs.sets]
    data, conditions = _held_lines(held, nodes, units)
    data += maps.data()
    conditions += [*ties.constraints(mesh.node_tags, nodes, units), *rigid_conditions(body, first_rigid)]
    lines = [
        *HEAD,
        f'<Module type="solid">{system}</Module>',
        _CONTROL,
        "<Material>",
        *(ET.tostring(card, encoding="unicode").strip() for card in cards),
        *rigid_materials(body, first_rigid, units),
        "</Material>",
        *_mesh(mesh_lines(mesh, mesh.points / units.length, elements, parts), springs.nodes, sets),
        "<MeshDomains>",
        *_domains(body, parts, elements, cards),
        "</MeshDomains>",
        *_section("MeshData", data),
        "<Boundary>",
        *conditions,
        *springs.conditions,
        "</Boundary>",
        *rigid_loads(body, first_rigid, units),
        *_loads(body, units),
        *_section("Discrete", springs.discrete),
        _CURVE,
        *_output(path),
        "</febio_spec>",
    ]
    element = next(line for line in lines if line.startswith("<Elements ")).split('"')[1]
    deck = Deck(nodes, mesh.node_tags[nodes], element)
    advice = "Is the directory there, and writable?"
    write_output(path, ("\n".join(lines) + "\n").encode(), advice)
    write_output(expected_path(path), expected_table(body, deck, units).encode(), advice)
    return deck


def _section(name: str, lines: list[str]) -> Iterator[str]:
    if lines:
        yield from (f"<{name}>", *lines, f"</{name}>")


def _mesh(lines: Iterator[str], nodes: list[str], sets: list[str]) -> Iterator[str]:
    """Yield the lines of the mesh with further nodes and sets."""
    for line in lines:
        yield from nodes if line == "</Nodes>" else ()
        yield from sets if line == "</Mesh>" else ()
        yield line


def _refuse_conflicts(body: LoadedBody) -> None:
    """Raise ``OutputError`` for nodes of rigid bodies that something else holds: FEBio has no such constraint."""
    for remote in body.remotes:
        rigid = np.unique(body.rest.facets[remote.group.members])
        others = [(held.place, held.nodes) for held in body.held]
        others += [(slide.place, slide.nodes) for slide in body.slides]
        others += [(f.place, np.unique(body.rest.facets[f.group.members])) for f in body.foundations]
        others += [(r.place, np.unique(body.rest.facets[r.group.members])) for r in body.remotes if r is not remote]
        if place := next((place for place, nodes in others if np.isin(nodes, rigid).any()), None):
            text = f"{place}: shares nodes with the rigid region of {remote.place}, which FEBio cannot hold elsewhere"
            raise OutputError(text, "Let the regions have no node in common.")


def _determined(ties: Ties) -> Iterator[Held]:
    """Yield the displacements that slides in several planes determine."""
    for axis, nodes, values in ties.determined():
        yield Held(f"slides-{AXES[axis]}", nodes, axis, values)


def _domains(body: LoadedBody, parts: Iterable[str], elements: Ints, cards: Sequence[ET.Element]) -> Iterator[str]:
    for name, card in zip(parts, cards, strict=True):
        formulation = _formulation(body, elements, card)
        yield f'<SolidDomain name="{escape(name)}" mat="{escape(name)}" type="{formulation}"/>'
        if formulation == "elastic-solid" and wants_pressure(body.laws):
            text = "FEBio has no element with a pressure for this material, and is too stiff there"
            body.notes.append(f"material {name} ({card.get('type')}): {text}")


def _formulation(body: LoadedBody, elements: Ints, card: ET.Element) -> str:
    """Return the elements' formulation: ours, or one with a pressure where a law is nearly incompressible.

    By default, FEBio gives a pressure to hex8 of uncoupled laws alone.
    """
    if not wants_pressure(body.laws):
        return "elastic-solid"
    if elements.shape[1] == 4:
        return "ut4-solid"
    return "elastic-solid" if card.find("k") is None else "three-field-solid"


def _materials(body: LoadedBody, maps: FibreMaps, units: Units) -> Iterator[ET.Element]:
    for number, (region, law) in enumerate(body.laws.items(), 1):
        name = region or _BODY
        try:
            text = febio.write(Values(law, febio.PROGRAM, units.stress), name, maps.of(name, law))
            card = ET.fromstring(text)
        except JobError as error:
            raise OutputError(f"material: {error.problems[0]}", "Take a law that both programs have.") from None
        card.set("id", str(number))
        if body.density:
            ET.SubElement(card, "density").text = repr(body.density_of(region) / units.density)
        yield card


def _set_of(held: Held) -> str:
    """Return the name of the node set of a region, or of nodes outside of regions."""
    return held.region or f"{held.place}-nodes"


def _node_sets(held: Sequence[Held], mesh: MeshSource, nodes: Ints) -> Iterator[str]:
    """Yield the sets of held nodes outside of regions of facets."""
    done = set[str]()
    for entry in held:
        if not entry.region and (name := _set_of(entry)) not in done:
            done.add(name)
            listed = ",".join(map(str, mesh.node_tags[entry.nodes[np.isin(entry.nodes, nodes)]].tolist()))
            yield f'<NodeSet name="{escape(name)}">{listed}</NodeSet>'


def _held_lines(held: Sequence[Held], nodes: Ints, units: Units) -> tuple[list[str], list[str]]:
    """Return data and conditions of what is held; displacements that vary over a region are data at its nodes."""
    data, conditions = list[str](), list[str]()
    for place, group in groupby(held, key=lambda entry: entry.place):
        entries = list(group)
        fixed = {entry.axis for entry in entries if not entry.values.any()}
        region = escape(_set_of(entries[0]))
        if fixed:
            dofs = "".join(f"<{axis}_dof>{int(i in fixed)}</{axis}_dof>" for i, axis in enumerate(AXES))
            conditions.append(f'<bc name="{place}" node_set="{region}" type="zero displacement">{dofs}</bc>')
        for entry in entries:
            if entry.axis not in fixed:
                values = entry.values[np.isin(entry.nodes, nodes)] / units.length
                data += _data(entry, values)
                conditions.append(_prescribed(entry, values))
    return data, conditions


def _name(held: Held) -> str:
    return f"{held.place}-{AXES[held.axis]}"


def _data(held: Held, values: Floats) -> Iterator[str]:
    if is_uniform(values):
        return
    yield f'<NodeData name="{_name(held)}" node_set="{escape(_set_of(held))}" data_type="scalar">'
    yield from (f'<node lid="{number}">{value!r}</node>' for number, value in enumerate(values.tolist(), 1))
    yield "</NodeData>"


def _prescribed(held: Held, values: Floats) -> str:
    size = f">{float(values.mean())!r}" if is_uniform(values) else f' type="map">{_name(held)}'
    return (
        f'<bc name="{_name(held)}" node_set="{escape(_set_of(held))}" type="prescribed displacement">'
        f'<dof>{AXES[held.axis]}</dof><value lc="1"{size}</value><relative>0</relative></bc>'
    )


def _loads(body: LoadedBody, units: Units) -> Iterator[str]:
    yield "<Loads>"
    for group, pressure in body.pressures:
        yield (
            f'<surface_load surface="{escape(group.name)}" type="pressure">'
            f'<pressure lc="1">{pressure / units.stress!r}</pressure><linear>0</linear></surface_load>'
        )
    for group, traction, is_current in body.tractions:
        entries = ",".join(repr(float(entry) / units.stress) for entry in traction)
        yield (
            f'<surface_load surface="{escape(group.name)}" type="traction"><scale lc="1">1</scale>'
            f"<traction>{entries}</traction><linear>{int(not is_current)}</linear></surface_load>"
        )
    if body.density and body.acceleration.any():
        entries = ",".join(
            repr(-float(entry) / units.length) for entry in body.acceleration
        )  # FEBio's sign is the opposite
        yield f'<body_load type="body force"><force lc="1">{entries}</force></body_load>'
    yield "</Loads>"


def displacement_path(model: Path) -> Path:
    """Return the file into which FEBio writes the displacements of a model's nodes."""
    return model.with_name(f"{model.stem}-displacement.txt")


def _output(path: Path) -> Iterator[str]:
    yield "<Output>"
    yield '<plotfile type="febio"><var type="displacement"/><var type="stress"/></plotfile>'
    name = escape(displacement_path(path).name)
    yield f'<logfile><node_data name="displacement" data="ux;uy;uz" delim="," file="{name}"/></logfile>'
    yield "</Output>"


def _add_traction(body: LoadedBody, effect: Any, place: str) -> None:
    traction = np.array(effect.traction, dtype=np.float64)
    body.tractions.append((group_of(body.rest, effect.region), traction, effect.area_in == "current"))


def _add_gravity(body: LoadedBody, effect: Any, place: str) -> str | None:
    if effect.density_in != "reference":
        return "'gravity' per deformed volume has no counterpart; FEBio's density is of the rest body"
    return WRITERS[Gravity](body, effect, place)


LOADS: Writers = {
    **WRITERS,
    Traction: _add_traction,
    Gravity: _add_gravity,
    ElasticFoundation: add_foundation,
}
"""What is written; every other effect is refused by its name."""
