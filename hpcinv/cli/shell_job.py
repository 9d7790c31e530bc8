"""Jobs of shells from another program's file: faces and edges of the loads, and what holds the director."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hpcinv.base.quantity.units import as_float, parse_unit
from hpcinv.base.reading.mesh_format import INNER, OUTER
from hpcinv.cli.file_job import FileJob
from hpcinv.formats.cards.card import Card, CardError, UnknownLaw
from hpcinv.formats.cards.deck import Axes, Deck, Measure, NodalForces, ShellSection, layer_name
from hpcinv.formats.cards.orthotropic import FAMILIES
from hpcinv.job.shell_section import Shell
from hpcinv.mesh.midsurface import thicken
from hpcinv.mesh.source import Floats, Group, MeshSource

_SAME = 1e-6
"""component of a unit vector, or relative difference of numbers, below which it counts as 0; raised, oblique edges
count as aligned"""
_DRILLING = 0.05
"""Part of the director that a rotation about the normal may move; raised, supports are lost without a word"""
_TURNED = 1e-3
"""Share of a moment about the normal or in other directions above which the moment is left out; raised, more is lost"""
_PLACES = {0.0: "middle", 0.5: OUTER, -0.5: INNER}
"""where the nodes of a shell are, by their offset along the outer normal over the thickness"""


class ShellJob(FileJob):
    """A job whose mesh is the midsurface of a shell, or one of its faces."""

    def __init__(
        self,
        options: argparse.Namespace,
        program: str,
        surface: MeshSource,
        deck: Deck,
        text: str,
        sets: Mapping[str, frozenset[int]],
        sides: Mapping[str, int],
    ) -> None:
        unit = as_float(parse_unit(options.unit)[0])
        surface = replace(surface, points=surface.points * unit, unit=unit)
        cells = {group.name.lower() for group in surface.groups if group.dim == 3}
        self._section = _with_uniform_thickness(_common(deck.shells, cells), surface)
        unit_name = options.unit
        thickness: Any = {"data": self._section.array, "unit": unit_name}
        if not self._section.array:
            thickness = f"{self._section.thickness:.15g} {unit_name}"
        shell: dict[str, Any] = {"thickness": thickness}
        oriented = thicken(surface, Shell.model_validate(shell)).midsurface
        assert oriented is not None
        self._is_turned = (oriented.cells != surface.cells).any(axis=1)  # elements whose normals point inwards
        shell |= self._faces()
        body = thicken(surface, Shell.model_validate(shell))
        super().__init__(options, program, body, deck, text, sets, sides)
        self._shell, self._surface = shell, surface
        through = body.points.reshape(-1, len(surface.points), 3)[[0, -1]]
        directors = through[1] - through[0]
        self._normals = directors / np.linalg.norm(directors, axis=1, keepdims=True)
        for section in deck.shells:
            if section.is_membrane:
                self._comments.append(f"Membranes of {section.region} became a shell, which has bending stiffness too.")
        deck.unused += [f"*COUPLING of '{rigid.region}' to a node: shells have none" for rigid in deck.remotes]
        deck.remotes.clear()

    def _faces(self) -> dict[str, Any]:
        """Return where the nodes are in the shell, and its layers from the inner face on."""
        section = self._section
        if not section.offset and len(section.layers) == 1:
            return {}
        if self._is_turned.any() and not self._is_turned.all():
            text = (
                f"its shell has {np.count_nonzero(self._is_turned):,} elements whose normals oppose their neighbours'"
            )
            raise CardError(f"{text}, and an offset or layers: turn the elements so that all normals agree")
        sign = -1 if self._is_turned.any() else 1
        place = _PLACES.get(sign * section.offset)
        if place is None:
            text = f"its shell has OFFSET={section.offset:g}, which has no counterpart"
            raise UnknownLaw(f"{text}; move its nodes to the middle (0) or to a face (0.5, -0.5)")
        layers = [(layer_name(number), thickness) for number, (_, thickness) in enumerate(section.layers, 1)]
        shell: dict[str, Any] = {} if place == "middle" else {"surface": place}
        return shell | ({"layers": dict(layers[::sign])} if len(layers) > 1 else {})

    def _mesh(self) -> dict[str, Any]:
        return {**super()._mesh(), "shell": self._shell}

    def _with_axes(self, card: Card, region: str) -> Card:
        """Return a card whose axes 1 and 2 are along a flat shell; others follow the surface, which no job can say."""
        fibres = card.law.fibres
        if None not in fibres.values():
            return card
        frame = self._deck.axes.get(region, Axes()).frame
        is_flat = bool(frame) and bool((np.abs(self._normals @ np.array(frame[2])) > 1 - _SAME).all())
        if is_flat and list(fibres) == list(FAMILIES):
            return replace(card, law=replace(card.law, fibres=dict(zip(fibres, frame, strict=True))))
        names = ", ".join(dict.fromkeys(name for section in self._deck.shells for name in section.orientations if name))
        axes = f"*ORIENTATION {names}" if names else "the axes of the coordinates"
        text = f"{card.title}: its axes in '{region}' follow the surface ({axes}), which has no counterpart"
        raise UnknownLaw(f"{text}; give its regions laws and 'fibres' in a job of your own")

    def _positions(self, tags: Sequence[int]) -> Floats:
        return np.asarray(self._surface.points[[self._row[tag] for tag in tags]] / (self._surface.unit or 1.0))

    def _supports(self, entry: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
        """Yield supports of the band of an edge, and of its midsurface about which it turns."""
        turns = set(entry.get("turns", ()))
        name, region = entry["region"], self._region(entry["region"])
        plain = {key: value for key, value in entry.items() if key != "turns"}
        if region is None or plain.get("fix") == ["normal"]:
            yield from super()._supports(plain) if plain.get("fix", True) else ()
            return
        values = dict(zip("xyz", plain.get("displacement", (None,) * 3), strict=True))
        held = [axis for axis in "xyz" if values[axis] is not None] or list(plain.get("fix", ()))
        bands = self._bands(name, region, held, turns)
        hinges = [axis for axis in held if axis not in bands]
        for axes, hinge in ((bands, {}), (hinges, {"hinge": True})):
            if axes and "displacement" in plain:
                parts = [values[axis] if axis in axes else None for axis in "xyz"]
                yield {"region": region, "displacement": self._with_units(parts), **hinge}
            elif axes:
                yield {"region": region, "fix": axes, **hinge}
        if held:
            yield from self._vertex_supports(plain)

    def _bands(self, name: str, region: str, held: Sequence[str], turns: set[str]) -> list[str]:
        """Return the held axes along which the director is held too; list the rotations that are not taken."""
        about = {axis: self._turning_axes(region, axis) for axis in "xyz"}
        is_clamped = set(held) == turns == set("xyz")
        bands = [axis for axis in held if (about[axis] or is_clamped) and about[axis] <= turns]
        if loose := [axis for axis in held if axis not in bands and about[axis] & turns]:
            text = f"rotations of '{name}' about {', '.join(sorted(turns))}: the director turns with {', '.join(loose)}"
            self._deck.unused.append(f"{text} in this job")
        used = set[str]().union(*(about[axis] for axis in [*bands, *loose]))
        moving = set[str]().union(*(self._turning_axes(region, axis, _DRILLING) for axis in "xyz"))
        if extra := sorted((turns - used) & moving):
            text = f"rotations of '{name}' about {', '.join(extra)}, where displacements of the director are free"
            self._deck.unused.append(text)
        return bands

    def _named_vertices(self, name: str, tags: list[int]) -> str:
        own = name.removesuffix("_vertices")
        self._comments.append(f"Nodes of '{own}' that span no edge are held at the inner face, where they may turn.")
        return super()._named_vertices(name, tags)

    def _turning_axes(self, region: str, axis: str, least: float = _SAME) -> set[str]:
        """Return the axes of the rotations that move the director along an axis, at the nodes of a region.

        Args:
            least: part of a turned unit vector that counts as a motion.
        """
        normals = self._normals[self._nodes(region)]
        rates = np.abs(np.cross(normals, np.eye(3)["xyz".index(axis)])).max(axis=0)
        return {other for other, rate in zip("xyz", rates, strict=True) if rate > least}

    def _nodes(self, region: str) -> Any:
        """Return the rows of the nodes of a region of the surface."""
        parts = [
            (self._surface.cells if group.dim == 3 else self._surface.facets)[group.members].ravel()
            for group in self._surface.groups
            if group.name == region
        ]
        return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *parts]))

    def _placed(self, entry: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return a load with its face or edge; ``None`` if there is none."""
        face = entry.get("face")
        plain = {key: value for key, value in entry.items() if key != "face"}
        name = entry.get("region", "")
        region = self._region(name) if name else None
        if region is not None and face == "edge":
            return self._edge_load(plain, region)
        cells = [group for group in self._surface.groups if group.name == region and group.dim == 3]
        if region is None or face is None or not cells:
            return super()._placed(plain)
        side = -1 if face == "back" else self._sides.get(name, 0)
        where = self._face_of(cells, side)
        if where is None:
            text = f"pressure on '{name}', whose elements have opposite normals or faces"
            self._deck.unused.append(f"{text}: turn them, so that all agree")
            return None
        placed = {key: self._with_units(value) for key, value in plain.items()}
        return {**placed, "region": f"{region}|{where}"}

    def _face_of(self, cells: Iterable[Group], side: int) -> str | None:
        """Return the face of cells on a side of their elements' normals; ``None`` if these are opposite."""
        turned = {bool(entry) for group in cells for entry in self._is_turned[group.members]}
        if len(turned) > 1 or not side:
            return None
        return OUTER if (side > 0) != turned.pop() else INNER

    def _edge_load(self, entry: Mapping[str, Any], region: str) -> dict[str, Any] | None:
        """Return the pressure on the band of an edge for a force by length."""
        if self._section.array:
            self._deck.unused.append(f"force on the edge '{region}', whose thickness varies: state a pressure")
            return None
        pressure = Measure(entry["pressure"].value / self._section.thickness, stress=1)
        return {**entry, "region": region, "pressure": self._with_units(pressure)}

    def _loaded_groups(self, region: str) -> list[Group]:
        """Return both faces of the cells of a region, else its edges."""
        if any(group.name == region and group.dim == 3 for group in self._surface.groups):
            names = {f"{region}|{face}" for face in (OUTER, INNER)}
            return [group for group in self._source.groups if group.name in names]
        return super()._loaded_groups(region)

    def _tractions(self, nodal: NodalForces) -> Iterator[dict[str, Any]]:
        region = self._region(nodal.region) if nodal.region else None
        if region is None or not self._has_strays(nodal, region):
            yield from super()._tractions(nodal)

    def _has_strays(self, nodal: NodalForces, region: str) -> bool:
        """Return whether some nodes of a load are on no edge and cell of its region; then it is listed as not taken."""
        inside = set(self._surface.node_tags[self._nodes(region)].tolist())
        strays = [tag for tag, vector in nodal.forces.items() if any(vector) and tag not in inside]
        if strays:
            text = f"{nodal.title}: {len(strays):,} of its nodes are on no edge and cell of '{region}'"
            self._deck.unused.append(f"{text}; load edges and faces apart")
        return bool(strays)

    def _couples(self, nodal: NodalForces) -> dict[str, Any] | None:
        """Return the moment per length of an edge that has the resultant of moments; ``None`` if it has none."""
        region = self._region(nodal.region) if nodal.region else None
        moments = np.array(list(nodal.forces.values())).reshape(-1, 3)
        edges = [group for group in self._surface.groups if group.name == region and group.dim == 2]
        total, size = moments.sum(axis=0), float(np.linalg.norm(moments, axis=1).sum())
        if not size:
            return None
        if region is None or not edges:
            self._deck.unused.append(f"{nodal.title}, which span no edge")
            return None
        if self._has_strays(nodal, region):
            return None
        nodes = self._surface.facets[np.concatenate([group.members for group in edges])]
        about_normals = np.abs(self._normals[nodes.ravel()] @ total).max()
        if float(np.linalg.norm(total)) < (1 - _TURNED) * size or about_normals > _TURNED * size:
            self._deck.unused.append(f"{nodal.title}, whose directions vary or which turn the edge in the surface")
            return None
        line = self._surface.points[nodes[:, [0, *range(2, nodes.shape[1]), 1]]] / (self._surface.unit or 1.0)
        length = float(np.linalg.norm(np.diff(line, axis=1), axis=2).sum())
        self._comments.append(f"{nodal.title} became a uniform moment on '{region}' with the same resultant")
        parts = [self._with_units(Measure(float(part), length=2, stress=1)) for part in total / length]
        return {"effect": "edge-moment", "region": region, "moment": parts}

    def _effects(self) -> list[dict[str, Any]]:
        return [*super()._effects(), *(entry for entry in map(self._couples, self._deck.moments) if entry)]


def _with_uniform_thickness(section: ShellSection, surface: MeshSource) -> ShellSection:
    """Return a section with one number if the thickness is the same at all nodes."""
    array = surface.data.get(section.array)
    if array is None or float(np.ptp(array.values)) > _SAME * float(np.abs(array.values).max(initial=0.0)):
        return section
    return replace(section, array="", layers=((section.layers[0][0], float(array.values[0, 0])),))


def _common(sections: Sequence[ShellSection], cells: set[str]) -> ShellSection:
    """Return the section of a file whose sections differ in their material only.

    Args:
        cells: names of sets that have elements, in lower case.
    """
    used = [s for s in sections if s.region.rpartition(".")[2].lower() in cells or not s.region] or list(sections)
    first = used[0]
    for other in used[1:]:
        is_same = (first.offset, first.array, len(first.layers)) == (other.offset, other.array, len(other.layers))
        stacks = [[t for _, t in section.layers] for section in (first, other)]
        if len(first.layers) > 1 and first.layers != other.layers:
            is_same = False
        if not is_same or stacks[0] != stacks[1]:
            text = f"shells of {first.region} and {other.region} have other thicknesses, offsets or layers"
            raise UnknownLaw(
                f"{text} ({first.thickness:g} and {other.thickness:g} in all): a director cannot jump;"
                " give the thickness by *NODAL THICKNESS, or solve the parts apart"
            )
    return first
