"""A job of the mesh, materials, supports and loads that another program's file has."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from hpcinv.base.files.names import escaped_line
from hpcinv.cli.deck_lines import lines_of

if TYPE_CHECKING:
    from hpcinv.formats.cards.card import Card
    from hpcinv.formats.cards.deck import Deck, NodalForces, RigidRegion
    from hpcinv.mesh.source import Floats, Group, MeshSource

_MOST_VERTICES = 200
"""Vertices of a support that a job lists; raised, jobs may become very long"""
_BALANCED = 0.01
"""Share of the forces at nodes below which their resultant, or their moment, counts as none"""


def _note_on_traction(what: str, region: str | None, share: float, strays: int) -> Iterator[str]:
    """Yield parts of a sentence on nodal forces that became a traction.

    Args:
        share: their moment about the centre of the region, by their size and distance.
        strays: number of nodes on no facet of it.
    """
    yield f"{what} a uniform traction on '{region}' with the same resultant"
    if share > _BALANCED:
        yield f"; their moment about its centre, {share:.0%} of their size by the distance, is lost"
    if strays:
        yield f"; {strays:,} of its nodes are on no facet of the region"


class FileJob:
    """A job of what another program's file says.

    Args:
        source: the mesh of the file, in its unit of length.
        sides: by the name of a surface, the face of the elements of a shell: 1 on the side of their normals, else -1; 0
            of both.
    """

    def __init__(
        self,
        options: argparse.Namespace,
        program: str,
        source: MeshSource,
        deck: Deck,
        text: str,
        sets: Mapping[str, frozenset[int]],
        sides: Mapping[str, int],
    ) -> None:
        self._options, self._program, self._source, self._deck, self._text = options, program, source, deck, text
        self._sets, self._sides = sets, sides
        self._regions = {group.name.lower(): group.name for group in source.groups}
        self._vertices: dict[str, dict[str, Any]] = {}  # regions of vertices, by name
        self._comments = [f"Made by hpcinv new job --from {options.source}; read what it says, and change it."]

    def text(self) -> str:
        """Return the job as YAML with comments."""
        import yaml

        supports = [support for entry in self._deck.supports for support in self._supports(entry)]
        supports += [entry for entry in map(self._remote, self._deck.remotes) if entry]
        effects = self._effects()
        sections = self._materials()
        self._comments += self._remarks()
        self._comments = list(dict.fromkeys(self._comments))
        for text in dict.fromkeys(self._deck.unused):
            self._comments.append(f"Not taken from the file: {text}{lines_of(text, self._options.source)}")
        self._comments += self._advice(supports, effects)
        names = [group.name for group in self._source.groups]
        self._comments.append(f"Regions of the mesh: {', '.join(dict.fromkeys(names)) or 'none'}")
        job = {
            "job": self._options.output.stem,
            "analysis": "forward",
            "mesh": self._mesh(),
            **({"regions": self._vertices} if self._vertices else {}),
            **sections,
            "effects": effects,
            "supports": supports or [{"region": self._anywhere(), "fix": ["x", "y", "z"]}],
        }
        self._comments.append("'analysis: forward' takes the mesh for unloaded; 'inverse' takes it for loaded.")
        lines = [f"# {escaped_line(comment)}\n" for comment in self._comments]
        body = yaml.safe_dump(job, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
        return "".join([*lines, body])

    def _remarks(self) -> Iterator[str]:
        """Yield what a reader of the job must know of the file."""
        from hpcinv.formats.readers.elements import loose_nodes

        if self._deck.is_linear:
            yield "The file is solved for small displacements (without NLGEOM), this job for large ones."
        yield from loose_nodes(self._source)

    def _mesh(self) -> dict[str, Any]:
        """Return the section of the mesh."""
        file = os.path.relpath(self._options.source.resolve(), self._options.output.resolve().parent)
        return {"file": file, "unit": self._options.unit}

    def _effects(self) -> list[dict[str, Any]]:
        """Return the sections of the loads."""
        effects = [entry for entry in map(self._placed, self._deck.effects) if entry]
        return effects + [effect for forces in self._deck.forces for effect in self._tractions(forces)]

    def _anywhere(self) -> str:
        return next((group.name for group in self._source.groups if group.dim == 2), "boundary")

    def _region(self, name: str, of: str = "") -> str | None:
        """Return the region of a set, as the mesh has it; names in an assembly are of an instance.

        Args:
            of: ``nodes`` or ``surface``: which of the two is meant where the file has both by one name.
        """
        short = name.strip().lower()
        names = [short, short.rpartition(".")[2]]
        every = [*(f"{own}-{of}" for own in names if of), *names]
        return next((self._regions[own] for own in every if own in self._regions), None)

    def _dims(self, region: str | None) -> set[int]:
        """Return the dimensions of the groups of a region."""
        return {group.dim for group in self._source.groups if group.name == region}

    def _placed(self, entry: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return a section with units and the region of the mesh; ``None`` if there is no such region."""
        placed = {key: self._with_units(value) for key, value in entry.items() if key not in ("on", "of")}
        if isinstance(densities := entry.get("density"), Mapping):
            placed["density"] = {self._region(n) or n: self._with_units(value) for n, value in densities.items()}
        if "region" in entry:
            what = entry.get("effect", "support")
            region = self._region(entry["region"], entry.get("of", "surface" if "effect" in entry else "nodes"))
            if region is None:
                self._deck.unused.append(f"{what} on '{entry['region']}', which spans no facet of the mesh")
                return None
            placed["region"] = region
            if "dead_pressure" in placed:
                return self._dead_pressure(entry, placed)
        elif names := [name for name in entry.get("on", ()) if name]:
            members = {cell for name in names for cell in self._cells(name)}
            if len(members) < len(self._source.cells):
                self._comments.append(f"{entry['effect']} on {', '.join(names)} acts on the whole body in this job.")
        return placed

    def _dead_pressure(self, entry: Mapping[str, Any], placed: dict[str, Any]) -> dict[str, Any] | None:
        """Return the traction that a pressure on the undeformed surface is if that is flat; else ``None``."""
        from hpcinv.formats.cards.deck import Measure
        from hpcinv.mesh.surface_normals import flat_normal

        rows = [g.members for g in self._source.groups if g.name == placed["region"] and g.dim == 2]
        normal = flat_normal(self._source, rows[0]) if rows else None
        if normal is None:
            self._deck.unused.append(f"a dead pressure on {placed['region']}, which is not flat")
            return None
        pressure: Measure = entry["dead_pressure"]
        traction = [self._with_units(Measure(-pressure.value * float(part) + 0.0, stress=1)) for part in normal]
        return {"effect": "traction", "region": placed["region"], "traction": traction, "area_in": "reference"}

    @cached_property
    def _row(self) -> Mapping[int, int]:
        """Row of each node by its number."""
        return {tag: row for row, tag in enumerate(self._source.node_tags.tolist())}

    @cached_property
    def _points(self) -> Floats:
        """Nodes (n, 3) in the unit of the file."""
        return self._source.points / (self._source.unit or 1.0)

    def _supports(self, entry: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
        """Yield the section of a support, and one of the vertices of its set that span no facet."""
        region = self._region(entry["region"], entry.get("of", "nodes"))
        if region is not None and self._dims(region) == {3} and entry.get("of") == "part":
            yield from self._part_supports(entry, region)
            return
        if 2 in self._dims(region) and (placed := self._placed(entry)) is not None:
            yield placed
        yield from self._vertex_supports(entry)

    def _part_supports(self, entry: Mapping[str, Any], region: str) -> Iterator[dict[str, Any]]:
        """Yield the support of all nodes of a part: on the boundary if it is the whole body, else at its vertices."""
        from hpcinv.mesh.cells import vertex_count

        source, plain = self._source, {key: self._with_units(value) for key, value in entry.items() if key != "of"}
        cells = self._cells(region)
        vertices = set(source.node_tags[source.cells[cells][:, : vertex_count(source.kind)]].ravel().tolist())
        if len(set(cells)) == len(source.cells):
            self._comments.append(
                f"The support on '{region}', which is the whole body, holds its boundary in this job."
            )
            yield plain | {"region": "boundary"}
        elif len(vertices) <= _MOST_VERTICES:
            yield plain | {"region": self._named_vertices(f"{region}_vertices", sorted(vertices))}
        else:
            text = f"support on the part '{region}' of {len(vertices):,} vertices: hold a face of it"
            self._deck.unused.append(text)

    def _vertex_supports(self, entry: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
        """Yield the section of a support at the vertices of its set that span no facet."""
        name = entry["region"]
        region = self._region(name, entry.get("of", "nodes"))
        vertices = self._lost_vertices(name, region)
        if len(vertices) > _MOST_VERTICES:
            text = f"support on {len(vertices):,} vertices of '{name}', which span no facet of the mesh"
            self._deck.unused.append(text)
        elif vertices:
            own = self._named_vertices(f"{name}_vertices", self._with_neighbours(name, vertices))
            plain = {key: self._with_units(value) for key, value in entry.items() if key != "of"}
            yield plain | {"region": own}
        elif 2 not in self._dims(region):
            self._deck.unused.append(f"support on '{name}', which has no vertex of the mesh")

    def _named_vertices(self, name: str, tags: list[int]) -> str:
        """Return the name of a region of vertices, which has the form of an identifier."""
        own = re.sub(r"\W", "_", name, flags=re.ASCII)
        own = own if own[:1].isalpha() else f"set_{own}"
        points = self._points[[self._row[tag] for tag in tags]]
        places = [[f"{x + 0.0:.12g} {self._options.unit}" for x in point] for point in points.tolist()]
        self._vertices[own] = {"vertices": places}
        return own

    def _lost_vertices(self, name: str, region: str | None) -> list[int]:
        """Return the numbers of the vertices of a node set that are on no facet of its region."""
        from hpcinv.mesh.cells import FACET_KIND, vertex_count

        source, tags = self._source, self._source.node_tags
        cells = source.cells[:, : vertex_count(source.kind)]
        facets = source.facets[:, : vertex_count(FACET_KIND[source.kind])]
        wanted = self._members(name) & set(tags[cells].ravel().tolist())
        found: set[int] = set()
        for group in source.groups:
            if group.name == region and group.dim == 2:
                found.update(tags[facets[group.members]].ravel().tolist())
        return sorted(wanted - found)

    def _members(self, name: str) -> frozenset[int]:
        """Return the numbers of the nodes of a set."""
        spelled = {own.lower(): own for own in self._sets}
        own = spelled.get(name.lower()) or spelled.get(name.lower().rpartition(".")[2], "")
        return self._sets.get(own, frozenset())

    def _with_neighbours(self, name: str, lost: list[int]) -> list[int]:
        """Return vertices on no facet of a set, and those that an edge joins to them whose nodes are all in the set.

        A region of vertices holds the edges between them: the file holds such an edge to a facet, too.
        """
        import numpy as np

        from hpcinv.mesh.cells import scalar_element

        source = self._source
        local = np.array(scalar_element(source.kind, source.degree).entity_closure_dofs[1])  # two vertices come first
        edges = source.node_tags[source.cells][:, local].reshape(-1, local.shape[1])
        edges = edges[np.isin(edges, list(self._members(name))).all(axis=1)]
        edges = edges[np.isin(edges[:, :2], lost).any(axis=1), :2]
        return sorted({*lost, *edges.ravel().tolist()})

    def _remote(self, rigid: RigidRegion) -> dict[str, Any] | None:
        """Return the support of a region that one node moves; ``None`` if there is no such region."""
        region = self._region(rigid.region, rigid.of)
        if 2 not in self._dims(region):
            self._deck.unused.append(f"a rigid region '{rigid.region}', which has no facet")
            return None
        return {"region": region, **self._with_units(rigid.section)}

    def _positions(self, tags: Sequence[int]) -> Floats:
        """Return the places (n, 3) of nodes in the unit of the file."""
        return self._points[[self._row[tag] for tag in tags]]

    def _loaded_groups(self, region: str) -> list[Group]:
        """Return the groups of facets that bear forces at the nodes of a region."""
        return [group for group in self._source.groups if group.name == region and group.dim == 2]

    def _advice(self, supports: Sequence[Mapping[str, Any]], effects: Sequence[Any]) -> Iterator[str]:
        """Yield what a user should state or know."""
        if not supports:
            yield "No support is taken from the file: state 'supports', such as the line below."
        if not effects and not any({"displacement", "remote"} & entry.keys() for entry in supports):
            yield "No load is taken from the file: state 'effects'."
        if self._vertices:
            yield "Supports at vertices keep a body in place whose loads balance; hold facets where they carry a load."

    def _tractions(self, nodal: NodalForces) -> Iterator[dict[str, Any]]:
        """Yield the uniform traction that has the resultant of forces at nodes."""
        import numpy as np

        from hpcinv.formats.cards.deck import Measure
        from hpcinv.mesh.surface_normals import area_and_centre

        tags = [tag for tag in nodal.forces if tag in self._row]
        forces = np.array([nodal.forces[tag] for tag in tags]).reshape(-1, 3)
        region = self._region(nodal.region, nodal.of) if nodal.region else None
        groups = self._loaded_groups(region) if region else []
        size, resultant = float(np.linalg.norm(forces, axis=1).sum()), forces.sum(axis=0)
        if not size:
            return
        if not groups or float(np.linalg.norm(resultant)) < _BALANCED * size:
            why = "whose resultant vanishes" if groups else "which span no facet: load a spot of facets by a traction"
            self._deck.unused.append(f"{nodal.title}, {why}")
            return
        members = np.concatenate([group.members for group in groups])
        area, centre = area_and_centre(self._source, members, self._points)
        arms = self._positions(tags) - centre
        moment = float(np.linalg.norm(np.cross(arms, forces).sum(axis=0)))
        share = moment / (size * float(np.linalg.norm(arms, axis=1).max()))
        inside = set(self._source.node_tags[self._source.facets[members]].ravel().tolist())
        strays = sum(tag not in inside and any(nodal.forces[tag]) for tag in tags)
        self._comments.append("".join(_note_on_traction(f"{nodal.title} became", region, share, strays)))
        components = [self._with_units(Measure(float(part), stress=1)) for part in resultant / area]
        for name in dict.fromkeys(group.name for group in groups):
            yield {"effect": "traction", "region": name, "traction": components, "area_in": "reference"}

    def _cells(self, name: str) -> list[int]:
        """Return the rows of the cells of a set."""
        region = self._region(name)
        groups = [group for group in self._source.groups if group.name == region and group.dim == 3]
        return [cell for group in groups for cell in group.members.tolist()]

    @property
    def _unit_sizes(self) -> list[float]:
        """SI values of the units of length and stress."""
        from hpcinv.base.quantity.units import as_float, parse_unit

        return [as_float(parse_unit(unit)[0]) for unit in (self._options.unit, self._options.stress_unit)]

    def _with_units(self, value: Any) -> Any:
        from hpcinv.formats.cards.deck import Measure

        match value:
            case Measure(length=1, stress=0):
                return f"{value.value:.15g} {self._options.unit}{'/s^2' if value.time else ''}"
            case Measure(length=0, stress=1):
                return f"{value.value:.15g} {self._options.stress_unit}"
            case Measure(stress=1, time=0):  # a force or a moment
                sizes = self._unit_sizes
                unit = "N" if value.length == 2 else "N m"
                return f"{value.value * sizes[0] ** value.length * sizes[1]:.15g} {unit}"
            case Measure():  # with seconds: a density is a stress by the square of a velocity
                sizes = self._unit_sizes
                return f"{value.value * sizes[0] ** value.length * sizes[1] ** value.stress:.15g} kg/m^3"
            case list():
                return [self._with_units(entry) for entry in value]
            case dict():
                return {key: self._with_units(entry) for key, entry in value.items()}
        return value

    def _materials(self) -> dict[str, Any]:
        """Return the sections of the materials, by region if there are several."""
        from hpcinv.formats.cards.merged_sections import merged

        materials = self._deck.materials or {"": ""}
        sections = {name: self._material(material, name) for name, material in materials.items()}
        if all(section == next(iter(sections.values())) for section in sections.values()):
            self._note_cells_without_material(materials)
            return next(iter(sections.values()))
        regions = [(self._region(name), section) for name, section in sections.items()]
        return merged([(region, section) for region, section in regions if region])

    def _note_cells_without_material(self, names: Iterable[str]) -> None:
        """Say how many cells have no section in the file, and the only material in this job."""
        if all(name and 3 in self._dims(self._region(name)) for name in names):
            without = len(self._source.cells) - len({cell for name in names for cell in self._cells(name)})
            if without:
                self._comments.append(f"{without:,} elements have no material in the file; this job has one for all.")

    def _material(self, name: str, region: str) -> dict[str, Any]:
        """Return the sections of the material of a set; a linear isotropic one is neo-Hooke with the same moduli."""
        from hpcinv.cli.cards import checked_sections, program_module
        from hpcinv.formats.cards.card import Card, CardError

        linear = self._deck.linear.get(name) or (next(iter(self._deck.linear.values()), None) if not name else None)
        try:
            card = program_module(self._program).read(self._text, name or None)
        except CardError:
            if linear is None:
                raise
            kind = "an energy of Green's strains" if linear.fibres else "neo-hookean"
            self._comments.append(f"Linear elasticity {name} became {kind}, which agrees at small strain.")
            if self._program == "abaqus" and not (linear.fibres or self._deck.is_linear):
                self._comments.append("  CalculiX with NLGEOM takes 'law: st-venant-kirchhoff' there.")
            card = Card(name, f"linear elasticity {name}", linear)
        self._comments += [f"{card.title}: {note}" for note in card.law.notes]
        return checked_sections(self._with_axes(card, region), self._options.stress_unit)

    def _with_axes(self, card: Card, region: str) -> Card:
        """Return a card whose fibres have the directions of the axes of a set."""
        from hpcinv.formats.cards.card import CardError
        from hpcinv.formats.cards.deck import Axes
        from hpcinv.formats.cards.orthotropic import FAMILIES

        fibres = card.law.fibres
        if None not in fibres.values():
            return card
        axes = self._deck.axes.get(region, Axes())
        if not axes.frame and region in self._deck.axes:
            text = f"{card.title}: the axes of {region} vary over the body"
            raise CardError(f"{text}; remove its ORIENTATION=, and state {', '.join(fibres)} in 'fibres' of the job")
        known = axes.frame if list(fibres) == list(FAMILIES) else axes.fibres
        if len(known) < len(fibres):
            self._comments.append(f"{card.title}: the file has no directions: state {', '.join(fibres)} in 'fibres'.")
            return card
        return replace(card, law=replace(card.law, fibres=dict(zip(fibres, known, strict=False))))
