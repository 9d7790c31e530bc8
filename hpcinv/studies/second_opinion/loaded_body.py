"""A run as another program must load it: rest shape, laws, what is held, loads, and the body that it should find."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hpcinv.base.quantity.spatial_fields import Field, is_uniform
from hpcinv.errors import OutputError
from hpcinv.geometry.workshop.job_regions import with_job_regions, with_middles
from hpcinv.geometry.workshop.run_shapes import left_out, unchecked
from hpcinv.job.body_kinds import SOLID
from hpcinv.job.job import Job
from hpcinv.job.support import Support
from hpcinv.job.vocabulary import AXES
from hpcinv.mesh.source import Floats, Group, Ints, MeshSource
from hpcinv.model.discrete_model import default_quadrature
from hpcinv.output.run_directory import RunDirectory
from hpcinv.physics.effects import Effect
from hpcinv.physics.effects.gravity import Gravity
from hpcinv.physics.effects.pressure import Pressure
from hpcinv.physics.effects.traction import Traction
from hpcinv.physics.materials import MaterialLaw
from hpcinv.studies.second_opinion.fibre_directions import constant_directions, directions_in_cells
from hpcinv.studies.second_opinion.foundations import Foundation
from hpcinv.studies.second_opinion.nodal_forces import cell_forces, facet_forces
from hpcinv.studies.second_opinion.regions import group_of
from hpcinv.studies.second_opinion.remote_regions import RemoteRegion, remote_region
from hpcinv.studies.second_opinion.shell_parts import unwritten_of_shells
from hpcinv.studies.second_opinion.slides import Slide, slide_of
from hpcinv.studies.second_opinion.state_shapes import shapes_of, unwritten_of_other_states
from hpcinv.studies.second_opinion.uniform_loads import uniform_loads
from hpcinv.studies.second_opinion.uniform_parts import CellValues, with_uniform_parts

_IN_MIDDLE = "one direction in each cell, of its middle; the rule of the run has others within cells"
_ON_SURFACE = "held along the normals of the loaded body, by the displacement that the run found"


@dataclass(frozen=True)
class Held:
    """Nodes (rows) of a region whose displacement along an axis (0, 1, 2) is known, and its values (n,), m."""

    place: str
    nodes: Ints
    axis: int
    values: Floats
    region: str = ""


@dataclass(kw_only=True)
class LoadedBody:
    """What another program loads.

    Attributes:
        name: of the job.
        rest: mesh of the rest shape, m.
        loaded: where its nodes should be (n, 3), m.
        laws: by region; the name of one for the whole body is empty.
        forces: of dead loads at the nodes (n, 3), N.
        held: known displacements along axes.
        slides: known displacements along other directions.
        vertices: rows of the vertices of regions of vertices.
        remotes: regions that move as rigid bodies under a force and a moment.
        foundations: springs between the boundary and the ground.
        pressures: follower pressures, Pa, by their facets.
        tractions: tractions (3,), Pa, by their facets, and whether they are per loaded area; for programs that have
            them, instead of ``forces``.
        fibres: unit vectors (3,) of families whose direction does not vary over the rest body, by their names.
        fibre_fields: unit vectors of the other families on the rest body by their names, at the nodes of the cells
            (cells, nodes, 3) or one in each cell (cells, 1, 3); for programs that have them.
        expansion: coefficient (1/K) and change of temperature (K) of the whole body; empty without one.
        quadrature: degree of the quadrature of the run.
        is_mixed: whether its pressure is an unknown.
        density: of the rest body, kg/m³; 0 without weight. The largest of ``densities``, if there are some.
        densities: of the rest body, kg/m³, by region as ``laws``; empty if it is the same everywhere.
        cell_values: of fields in the job.
        acceleration: (3,), m/s².
        steps: further states of the same body, which are loaded after this one; for programs that have them.
        notes: what a reader should know of how the job is said.
    """

    name: str
    rest: MeshSource
    loaded: Floats
    laws: Mapping[str, MaterialLaw]
    forces: Floats
    vertices: Mapping[str, Ints] = field(default_factory=dict)
    held: list[Held] = field(default_factory=list)
    slides: list[Slide] = field(default_factory=list)
    remotes: list[RemoteRegion] = field(default_factory=list)
    foundations: list[Foundation] = field(default_factory=list)
    pressures: list[tuple[Group, float]] = field(default_factory=list)
    tractions: list[tuple[Group, Floats, bool]] = field(default_factory=list)
    fibres: Mapping[str, Floats] = field(default_factory=dict)
    fibre_fields: Mapping[str, Floats] = field(default_factory=dict)
    expansion: tuple[float, float] | tuple[()] = ()
    quadrature: int = 2
    is_mixed: bool = False
    density: float = 0.0
    densities: Mapping[str, float] = field(default_factory=dict)
    cell_values: CellValues | None = None
    acceleration: Floats = field(default_factory=lambda: np.zeros(3))
    steps: list[LoadedBody] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def displacement(self) -> Floats:
        """Displacement (n, 3) from the rest shape, m."""
        return self.loaded - self.rest.points

    def density_of(self, region: str) -> float:
        """Return the density of a region of ``laws``, kg/m³."""
        return self.densities.get(region, self.density)


type Writers = Mapping[type[Effect], Callable[[LoadedBody, Any, str], str | None]]
type Ability = Literal["slides", "remote", "shell", "vertices", "fibre fields"]
"""parts of a body that not every program has"""


def loaded_body(
    run: Path, writers: Writers | None = None, abilities: Collection[Ability] = (), state: str = ""
) -> LoadedBody:
    """Return the body of a finished run.

    Args:
        writers: as of `add_loads`.
        abilities: of the program; what needs others is refused.
        state: to load, of a job with states; empty for the given one.

    Raises:
        OutputError: it is not finished, its files lack nodes of the computed body, or it has what no deck can say; with
            a line for each part of the job.
    """
    doubt = unchecked(run)
    job = RunDirectory(run).job(None)
    _refuse(run, _kinds_without_deck(job, abilities))
    job, rest, loaded, given = shapes_of(run, job, state)
    _refuse(run, unwritten_of_other_states(job, is_given=given is rest or given is loaded))
    if rest.degree < job.discretisation.displacement or max(left_out(run, rest), left_out(run, loaded)) > 0:
        raise OutputError(
            f"{run}: its files have fewer nodes than the computed body",
            "Run it with 'mesh: {geometry_degree: 2}', or with 'discretisation: {displacement: 1}'.",
        )
    rest, vertices = with_job_regions(rest, given, job)
    laws = {where.removeprefix("material").removeprefix("."): law for where, law in job.laws.items()}
    density = _varying_density(run, job.effects)
    values = CellValues(rest, given.data, job)
    rest, laws, densities = with_uniform_parts(laws, density, values)
    body = LoadedBody(name=job.job, rest=rest, loaded=loaded.points, laws=laws, forces=np.zeros_like(rest.points))
    body.densities, body.vertices, body.cell_values = densities, vertices, values
    body.fibres = dict(constant_directions(job.fibres))
    if "fibre fields" in abilities:
        fields = directions_in_cells(job, rest, loaded)
        body.fibre_fields = {name: vectors for name, vectors in fields if name not in body.fibres}
        coarse = [name for name in body.fibre_fields if job.fibres[name].rule is not None]
        body.notes += [f"fibres.{name}: {_IN_MIDDLE}" for name in coarse]
    body.is_mixed, spaces = job.is_mixed, job.discretisation
    body.quadrature = spaces.quadrature or default_quadrature(rest.kind, spaces.displacement)
    faults = [*_supports(body, job, abilities), *add_loads(body, job.effects, writers)]
    _refuse(run, faults)
    body.notes += [doubt] if doubt else []
    return body


def _varying_density(run: Path, effects: Iterable[Effect]) -> Field | None:
    """Return the density of gravity that varies over the body, if one does; refuse a second gravity next to it."""
    densities = [effect.density for effect in effects if isinstance(effect, Gravity)]
    varying = [density for density in densities if isinstance(density, Field)]
    if varying and len(densities) > 1:
        _refuse(run, ["effects: a material has one density, and several effects 'gravity' have one each"])
    return varying[0] if varying else None


def _refuse(run: Path, faults: Iterable[str]) -> None:
    if lines := list(faults):
        text = "\n".join(f"  {line}" for line in lines)
        raise OutputError(f"{run}: a deck cannot say:\n{text}", "Solve a job without it, and export that.")


def _kinds_without_deck(job: Job, abilities: Collection[Ability]) -> Iterator[str]:
    """Yield what is not written for any program yet, and kinds of bodies that a program lacks."""
    kind = job.mesh.kind.name
    if kind in (SOLID.name, *abilities):
        yield from unwritten_of_shells(job)
    else:
        yield f"mesh.{kind}: only solids are written"
    for section in ("cavities", "interfaces", "accuracy"):
        if getattr(job, section):
            yield f"{section}: not written"


def _held_nodes(body: LoadedBody, support: Support) -> Ints:
    """Return the nodes (rows) that a support holds."""
    if support.region in body.vertices:
        return with_middles(body.rest, body.vertices[support.region])
    nodes = np.unique(body.rest.facets[group_of(body.rest, support.region).members])
    if not support.hinge:
        return nodes
    count = len(body.rest.points) // 3  # of one layer: the nodes half way
    return nodes[(nodes >= count) & (nodes < 2 * count)]


def _supports(body: LoadedBody, job: Job, abilities: Collection[Ability]) -> Iterator[str]:
    """Add what supports hold, with the displacement that the run found there; yield what cannot be said."""
    for number, support in enumerate(job.supports):
        place = f"supports[{number}]"
        if support.remote is not None:
            if "remote" in abilities:
                remote = remote_region(body.rest, body.loaded, job, support.remote, place, support.region)
                body.remotes.append(remote)
            else:
                yield f"{place}: 'remote' is a force on a rigid region"
            continue
        if support.region in body.vertices and "vertices" not in abilities:
            yield f"{place}: a support on vertices is not written"
            continue
        nodes = _held_nodes(body, support)
        region = "" if support.region in body.vertices else support.region
        for axis in sorted(AXES.index(axis) for axis in support.held):
            values = body.displacement[nodes, axis] if support.moves else np.zeros(len(nodes))
            body.held.append(Held(place, nodes, axis, values, region))
        if support.slides:
            slide = slide_of(body.rest, body.loaded, job, support, place)
            if slide.axis is not None:
                body.held.append(Held(place, nodes, slide.axis, slide.axis_values, support.region))
            elif "slides" in abilities:
                body.slides.append(slide)
                body.notes += [f"{place}: {_ON_SURFACE}"] if support.surface is not None else []
            else:
                yield f"{place}: 'fix: [normal]' holds a direction that is not an axis"


def add_loads(body: LoadedBody, effects: Iterable[Effect], writers: Writers | None = None) -> Iterator[str]:
    """Add loads; yield those that cannot be said.

    Args:
        writers: what adds an effect and may return why it cannot, by its class; by default `WRITERS`.
    """
    for number, whole in enumerate(effects):
        place, write = f"effects[{number}]", (WRITERS if writers is None else writers).get(type(whole))
        if write is None:
            yield f"{place}: '{whole.effect}' has no counterpart"  # type: ignore[attr-defined]
            continue
        parts = [whole]
        if body.cell_values is not None:
            body.rest, parts = uniform_loads(whole, body.rest, body.cell_values)
        for effect in parts:
            if not _has_numbers(effect, body):
                yield f"{place}: '{effect.effect}' has a number that varies, or that the run found"  # type: ignore[attr-defined]
            elif reason := write(body, effect, place):
                yield f"{place}: {reason}"


def _has_numbers(effect: Effect, body: LoadedBody) -> bool:
    """Return whether a load has known numbers, the same everywhere; the density may be of a region."""
    quantities = effect.quantities().items()
    return not effect.is_unknown and all(
        is_uniform(value) or (name == "density" and bool(body.densities)) for name, (value, _) in quantities
    )


def _add_pressure(body: LoadedBody, effect: Any, place: str) -> None:
    body.pressures.append((group_of(body.rest, effect.region), float(effect.pressure)))


def _add_traction(body: LoadedBody, effect: Any, place: str) -> None:
    facets = body.rest.facets[group_of(body.rest, effect.region).members]
    points = body.rest.points if effect.area_in == "reference" else body.loaded
    body.forces += facet_forces(body.rest, points, facets, np.array(effect.traction, dtype=np.float64))
    if effect.area_in == "current":
        body.notes.append(f"{place}: forces at the nodes, of the loaded area; they do not follow the deformation")


def _add_gravity(body: LoadedBody, effect: Any, place: str) -> str | None:
    acceleration = np.array(effect.acceleration, dtype=np.float64)
    if effect.density_in == "reference":
        if body.densities:
            body.density, body.acceleration = max(body.densities.values()), acceleration
        elif density := float(effect.density):
            body.density = body.density or density  # a material has one
            body.acceleration += density / body.density * acceleration
    elif body.densities:
        return "'gravity' per deformed volume has a density that varies"
    else:
        body.forces += cell_forces(body.rest, body.loaded, float(effect.density) * acceleration)
        body.notes.append(f"{place}: forces at the nodes, of the density in the loaded body")
    return None


def add_foundation(body: LoadedBody, effect: Any, place: str) -> None:
    """Add springs of an elastic foundation."""
    is_current = effect.area_in == "current"
    stiffness = (float(effect.normal or 0.0), float(effect.tangential or 0.0))
    body.foundations.append(Foundation(place, group_of(body.rest, effect.region), *stiffness, is_current))
    if is_current:
        body.notes.append(f"{place}: springs of the area and the normals of the loaded body")


WRITERS: Writers = {
    Pressure: _add_pressure,
    Traction: _add_traction,
    Gravity: _add_gravity,
}
"""What is written; every other effect is refused by its name."""
