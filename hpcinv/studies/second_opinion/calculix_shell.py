"""Whole decks of shells for CalculiX and Abaqus: elements on the middle surface, with thickness and directors.

CalculiX makes solids of one element through the thickness of these (C3D20R for S8R), and a rigid column of nodes where
rotations are held.

Source: Dhondt, *CalculiX CrunchiX User's Manual*, ``S8 and S8R``, ``*SHELL SECTION``, ``*NORMAL``.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path

import numpy as np

from hpcinv.base.files.atomic import write_output
from hpcinv.base.reading.mesh_format import INNER, OUTER
from hpcinv.errors import OutputError
from hpcinv.formats.inp import number
from hpcinv.mesh.cells import vtk_order
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.midsurface import surface_source
from hpcinv.mesh.source import Floats
from hpcinv.studies.second_opinion.calculix_deck import (
    CELLS,
    NODES,
    Deck,
    Program,
    card_of,
    expected_path,
    expected_table,
    heed_limits,
    nodal_forces,
    output_lines,
    set_rows,
    step_head,
    weight_lines,
)
from hpcinv.studies.second_opinion.loaded_body import Held, LoadedBody
from hpcinv.studies.second_opinion.units import Units

_LEVELS = 3
"""of nodes of a shell without layers: at the inner face, half way, and at the outer face"""
_SAME = 1e-9
"""Difference, relative to the largest, that is a rounding error; raised, a small rotation of an edge is lost."""
_MOMENT = 0.05
"""Moment of forces about the middle surface, relative to forces and thickness, that curved cells have; a traction on a
face has 0.5. Raised, moments are lost."""
_ACROSS = 0.05
"""Sine of the angle between a director and a plane of symmetry; raised, a rotation is held that is free here."""


class _Sheet:
    """The middle surface of a shell as a deck has it.

    Attributes:
        surface: at rest, m, with the thickness at its nodes.
        nodes: rows of the surface's nodes that elements have.
        columns: rows of the body's nodes (levels, n) at each node of the surface.
    """

    def __init__(self, body: LoadedBody, units: Units) -> None:
        rest = body.rest
        surface, points = surface_source(rest, rest.points)
        self.surface = dataclasses.replace(surface, points=points, read_as=(), unit=units.length)
        count = len(points)
        self.columns = np.arange(len(rest.points)).reshape(-1, count)
        self.elements = surface.cells[:, np.argsort(vtk_order(surface.kind, surface.degree))][:, :8]
        self.nodes = np.unique(self.elements)
        self.directors = surface.data["director"].values
        self.thickness = surface.data["thickness"].values[:, 0]


def write_shell(path: Path, body: LoadedBody, units: Units, program: Program) -> Deck:
    """Write the deck of a shell; as `write_deck`.

    Raises:
        OutputError: it cannot be written, or has layers or a surface that is not in the middle.
    """
    sheet = _Sheet(body, units)
    if faults := list(_faults(body, sheet, program)):
        raise OutputError(f"a deck of a shell cannot say: {'; '.join(faults)}", "Solve a job without it.")
    with tempfile.TemporaryDirectory() as directory:
        plain = Path(directory) / "mesh.inp"
        save(plain, dataclasses.replace(sheet.surface, data={}), sheet.surface.points)
        text = plain.read_text("utf-8")
    tags = sheet.surface.node_tags
    deck = Deck(sheet.columns[1][sheet.nodes], tags[sheet.nodes], "S8R")
    heed_limits(body, units, program)
    lines = [text, *_model(body, sheet, deck, units), *_step(body, sheet, deck, units, program)]
    advice = "Is the directory there, and writable?"
    write_output(path, "".join(lines).encode(), advice)
    write_output(expected_path(path), expected_table(body, deck, units).encode(), advice)
    return deck


def _faults(body: LoadedBody, sheet: _Sheet, program: Program) -> Iterator[str]:
    """Yield what is written for solids, and not for shells."""
    yield from (f"{foundation.place}: 'elastic-foundation'" for foundation in body.foundations)
    if body.expansion:
        yield "'thermal-expansion'"
    [law] = body.laws.values()
    if law.families:
        yield "material: directions of fibres"
    if law.is_incompressible and program == "calculix":
        yield "material: CalculiX has no elements for incompressible bodies"
    forces = body.forces[sheet.columns]
    arms = body.rest.points[sheet.columns] - body.rest.points[sheet.columns[1]]
    moments = np.linalg.norm(np.cross(arms, forces).sum(axis=0), axis=1)
    if moments.sum() > _MOMENT * (np.linalg.norm(forces.sum(axis=0), axis=1) * sheet.thickness).sum():
        yield "tractions on a face, whose moment about the middle surface would be lost"


def _model(body: LoadedBody, sheet: _Sheet, deck: Deck, units: Units) -> Iterator[str]:
    """Yield sets, thickness, directors, material, section, and what is fixed."""
    tags = sheet.surface.node_tags
    yield f"*NSET, NSET={NODES}\n"
    yield from set_rows(deck.tags.tolist())
    yield f"*ELSET, ELSET={CELLS}\n"
    yield from set_rows(sheet.surface.cell_tags.tolist())
    yield "*NODAL THICKNESS\n"
    for node in sheet.nodes.tolist():
        yield f"{tags[node]}, {number(float(sheet.thickness[node]) / units.length)}\n"
    yield "*NORMAL\n"
    for cell, nodes in zip(sheet.surface.cell_tags.tolist(), sheet.elements.tolist(), strict=True):
        for node in nodes:
            yield f"{cell}, {tags[node]}, {', '.join(map(number, sheet.directors[node].tolist()))}\n"
    [law] = body.laws.values()
    yield card_of(law, "BODY", units)
    if body.density:
        yield f"*DENSITY\n{number(body.density / units.density)}\n"
    yield f"*SHELL SECTION, ELSET={CELLS}, MATERIAL=BODY, NODAL THICKNESS\n"
    yield f"{number(float(sheet.thickness.mean()) / units.length)}\n"
    yield from _faces(body, sheet)
    yield from _held(body, sheet, units, moved=False)


def _held(body: LoadedBody, sheet: _Sheet, units: Units, *, moved: bool) -> Iterator[str]:
    lines = list[str]()
    tags, level = sheet.surface.node_tags, sheet.columns[1]
    for _, group in groupby(body.held, key=lambda held: held.place):
        entries = list(group)
        for held in entries:
            if bool(held.values.any()) is not moved:
                continue
            is_middle = np.isin(held.nodes, level[sheet.nodes])
            for node, value in zip(held.nodes[is_middle], held.values[is_middle].tolist(), strict=True):
                lines.append(
                    f"{tags[node - level[0]]}, {held.axis + 1}, {held.axis + 1}, {number(value / units.length)}\n"
                )
        if not moved:
            lines += _held_turns(entries, sheet)
    if lines:
        yield from ("*BOUNDARY\n", *lines)


def _held_turns(entries: list[Held], sheet: _Sheet) -> Iterator[str]:
    """Yield the rotations that a support of whole columns holds.

    Raises:
        OutputError: they are not about axes of the coordinates, or the columns turn.
    """
    first, level = entries[0], sheet.columns[1]
    if not np.isin(first.nodes, sheet.columns[0]).any():  # a hinge
        return
    nodes = np.intersect1d(first.nodes, level[sheet.nodes]) - level[0]
    axes = {held.axis for held in entries}
    for held in entries:
        values = np.full(len(sheet.columns.ravel()), np.nan)
        values[held.nodes] = held.values
        columns = values[sheet.columns][:, nodes]
        if np.ptp(columns, axis=0).max() > _SAME * np.abs(columns).max():
            raise OutputError(f"{first.place}: turns an edge, whose rotation a deck would need", "Use 'hinge: true'.")
    turns = {0, 1, 2} if len(axes) == 3 else set(_turns(axes, sheet.directors[nodes], first.place))
    for node in nodes.tolist():
        yield from (f"{sheet.surface.node_tags[node]}, {turn + 4}, {turn + 4}\n" for turn in sorted(turns))


def _turns(axes: Iterable[int], directors: Floats, place: str) -> Iterator[int]:
    """Yield the axes about which directors do not turn if their ends are held along ``axes``.

    Raises:
        OutputError: other rotations are held.
    """
    sizes = np.abs(directors).max(axis=0)
    for axis in axes:
        others = [i for i in range(3) if i != axis and sizes[i] > _ACROSS]
        if others and (len(others) > 1 or sizes[axis] > _ACROSS):
            text = f"{place}: holds directors along an axis that is not normal to them"
            raise OutputError(text, "Use 'hinge: true'.")
        if others:  # else the support holds the thickness, which does not change there
            yield 3 - axis - others[0]


def _step(body: LoadedBody, sheet: _Sheet, deck: Deck, units: Units, program: Program) -> Iterator[str]:
    yield from step_head(program)
    yield from _held(body, sheet, units, moved=True)
    yield from weight_lines(body, units)
    for place, (_, pressure) in enumerate(body.pressures, 1):
        yield f"*DSLOAD\nHPCINV_FACE_{place}, P, {number(pressure / units.stress)}\n"
    forces = np.zeros_like(body.forces)
    forces[sheet.columns[1]] = body.forces[sheet.columns].sum(axis=0)
    if lines := list(nodal_forces(forces, deck, units)):
        yield from ("*CLOAD\n", *lines)
    yield from output_lines()


def _faces(body: LoadedBody, sheet: _Sheet) -> Iterator[str]:
    """Yield the surfaces that pressures act on.

    Raises:
        OutputError: one is an edge.
    """
    for place, (group, _) in enumerate(body.pressures, 1):
        name = group.name.rpartition("|")[2]
        if name not in (INNER, OUTER):
            raise OutputError(f"effects: a pressure on '{group.name}' is on an edge of a shell", "Use a traction.")
        first = int(next(g for g in body.rest.groups if g.name == name).members[0])
        side = "SPOS" if name == OUTER else "SNEG"
        yield f"*SURFACE, NAME=HPCINV_FACE_{place}, TYPE=ELEMENT\n"
        yield from (f"{tag}, {side}\n" for tag in sheet.surface.cell_tags[group.members - first].tolist())
