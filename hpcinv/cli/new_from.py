"""``hpcinv new job --from FILE``: a job with the mesh, materials, supports and loads of another program's file."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.errors import JobError
from hpcinv.files.names import escaped_line
from hpcinv.reading.suffix import suffix_of

if TYPE_CHECKING:
    from hpcinv.cards.deck import Deck
    from hpcinv.mesh.source import MeshSource

_PROGRAMS = {".inp": "abaqus", ".feb": "febio", ".cdb": "ansys"}


def job_from(options: argparse.Namespace) -> str:
    """Return the content of a job."""
    import importlib

    from hpcinv.cards.card import LARGEST, CardError
    from hpcinv.cli.mesh_input import length_unit
    from hpcinv.mesh.io.isolated import read_isolated
    from hpcinv.mesh.readers import FILES
    from hpcinv.quantity.csv_rows import text_of

    path: Path = options.source
    program = _PROGRAMS.get(suffix_of(path))
    if program is None:
        raise JobError(f"--from {path}: is not an input file; the endings are {', '.join(_PROGRAMS)}")
    if options.unit is None or options.stress_unit is None:
        raise JobError("--from: files of other programs have no units; give them, as --unit mm --stress-unit MPa")
    length_unit(options.unit)
    source = FILES[suffix_of(path)](path)
    _, arrays = read_isolated(suffix_of(path)[1:], path, "cannot be read", "Is the file complete?")
    tags = arrays["node_tags"]
    sets = {key[6:]: frozenset(tags[rows].tolist()) for key, rows in arrays.items() if key.startswith("nodes:")}
    try:
        text = text_of(path, LARGEST)
        deck: Deck = importlib.import_module(f"hpcinv.cards.{program}_deck").read_deck(text, sets)
        return _Job(options, program, source, deck, text, sets).text()
    except CardError as error:
        raise CardError(*(f"{path}: {problem}" for problem in error.problems)) from None
    except ValueError as error:
        raise JobError(f"{path}: {error}") from None


class _Job:
    def __init__(
        self,
        options: argparse.Namespace,
        program: str,
        source: MeshSource,
        deck: Deck,
        text: str,
        sets: Mapping[str, frozenset[int]],
    ) -> None:
        self._options, self._program, self._source, self._deck, self._text = options, program, source, deck, text
        self._sets = sets
        self._regions = {group.name.lower(): group.name for group in source.groups}
        self._comments = [f"Made by hpcinv new job --from {options.source}; read what it says, and change it."]

    def text(self) -> str:
        """Return the job as YAML with comments."""
        import yaml

        supports = [entry for entry in map(self._placed, self._deck.supports) if entry]
        effects = [entry for entry in map(self._placed, self._deck.effects) if entry]
        sections = self._materials()
        self._comments += [f"Not taken from the file: {text}" for text in dict.fromkeys(self._deck.unused)]
        if not supports:
            self._comments.append("No support is taken from the file: state 'supports', such as the line below.")
        if not effects and not any("displacement" in entry for entry in supports):
            self._comments.append("No load is taken from the file: state 'effects'.")
        names = [group.name for group in self._source.groups]
        self._comments.append(f"Regions of the mesh: {', '.join(dict.fromkeys(names)) or 'none'}")
        mesh = os.path.relpath(self._options.source.resolve(), self._options.output.resolve().parent)
        job = {
            "job": self._options.output.stem,
            "analysis": "forward",
            "mesh": {"file": mesh, "unit": self._options.unit},
            **sections,
            "effects": effects,
            "supports": supports or [{"region": self._anywhere(), "fix": ["x", "y", "z"]}],
        }
        self._comments.append("'analysis: forward' takes the mesh for unloaded; 'inverse' takes it for loaded.")
        lines = [f"# {escaped_line(comment)}\n" for comment in self._comments]
        body = yaml.safe_dump(job, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
        return "".join([*lines, body])

    def _anywhere(self) -> str:
        return next((group.name for group in self._source.groups if group.dim == 2), "boundary")

    def _region(self, name: str) -> str | None:
        """Return the region of a set, as the mesh has it; names in an assembly are of an instance."""
        short = name.strip().lower()
        return self._regions.get(short) or self._regions.get(short.rpartition(".")[2])

    def _placed(self, entry: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return a section with units and the region of the mesh; ``None`` if there is no such region."""
        placed = {key: self._with_units(value) for key, value in entry.items() if key != "on"}
        if "region" in entry:
            what = entry.get("effect", "support")
            region = self._region(entry["region"])
            if region is None:
                self._deck.unused.append(f"{what} on '{entry['region']}', which spans no facet of the mesh")
                return None
            if what == "support" and (lost := self._lost(region)):
                self._deck.unused.append(f"support on {lost} of '{region}', which span no facet of the mesh")
            placed["region"] = region
        elif names := [name for name in entry.get("on", ()) if name]:
            members = {cell for name in names for cell in self._cells(name)}
            if len(members) < len(self._source.cells):
                self._comments.append(f"{entry['effect']} on {', '.join(names)} acts on the whole body in this job.")
        return placed

    def _lost(self, region: str) -> str:
        """Return how many vertices of a node set are on no facet and cell of its region; empty text if all are."""
        from hpcinv.mesh.cells import FACET_KIND, vertex_count

        source, tags = self._source, self._source.node_tags
        cells = source.cells[:, : vertex_count(source.kind)]
        facets = source.facets[:, : vertex_count(FACET_KIND[source.kind])]
        wanted = self._sets.get(region, frozenset()) & set(tags[cells].ravel().tolist())
        found: set[int] = set()
        for group in source.groups:
            if group.name == region:
                found.update(tags[(facets if group.dim == 2 else cells)[group.members]].ravel().tolist())
        lost = len(wanted - found)
        return f"{lost:,} of {len(wanted):,} vertices" if lost else ""

    def _cells(self, name: str) -> list[int]:
        """Return the rows of the cells of a set."""
        region = self._region(name)
        groups = [group for group in self._source.groups if group.name == region and group.dim == 3]
        return [cell for group in groups for cell in group.members.tolist()]

    def _with_units(self, value: Any) -> Any:
        from hpcinv.cards.deck import Measure

        match value:
            case Measure(length=1, stress=0):
                return f"{value.value:.15g} {self._options.unit}{'/s^2' if value.time else ''}"
            case Measure(length=0, stress=1):
                return f"{value.value:.15g} {self._options.stress_unit}"
            case Measure():  # with seconds: a density is a stress by the square of a velocity
                from hpcinv.quantity.units import as_float, parse_unit

                sizes = [as_float(parse_unit(unit)[0]) for unit in (self._options.unit, self._options.stress_unit)]
                return f"{value.value * sizes[0] ** value.length * sizes[1] ** value.stress:.15g} kg/m^3"
            case list():
                return [self._with_units(entry) for entry in value]
        return value

    def _materials(self) -> dict[str, Any]:
        """Return the sections of the materials, by region if there are several."""
        names = dict.fromkeys(self._deck.materials.values()) or {"": None}
        sections = {name: self._material(name) for name in names}
        if len(sections) == 1:
            return next(iter(sections.values()))
        merged: dict[str, Any] = {"material": {}}
        for region_name, name in self._deck.materials.items():
            if region := self._region(region_name):
                merged["material"][region] = sections[name]["material"]
            for key in ("let", "fibres"):
                merged |= {key: merged.get(key, {}) | sections[name][key]} if key in sections[name] else {}
        return merged

    def _material(self, name: str) -> dict[str, Any]:
        """Return the sections of a material; a linear one is neo-Hooke with the same moduli."""
        from hpcinv.cards.card import CardError
        from hpcinv.cli.cards import checked_sections, program_module

        linear = self._deck.linear.get(name) or (next(iter(self._deck.linear.values()), None) if not name else None)
        try:
            card = program_module(self._program).read(self._text, name or None)
        except CardError:
            if linear is None:
                raise
            self._comments.append(f"Linear elasticity {name} became neo-hookean, which agrees at small strain.")
            young = f"{linear[0]:.15g} {self._options.stress_unit}"
            return {"material": {"law": "neo-hookean", "young": young, "poisson": linear[1]}}
        self._comments += [f"{card.title}: {note}" for note in card.law.notes]
        return checked_sections(card, self._options.stress_unit)
