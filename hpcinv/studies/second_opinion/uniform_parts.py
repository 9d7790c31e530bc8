"""Parts of a body in which laws and density have one value: cards of materials have no fields."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hpcinv.base.quantity.spatial_fields import ELSEWHERE, ByData, ByRegion, Field, entries
from hpcinv.errors import OutputError
from hpcinv.job.job import Job
from hpcinv.mesh.source import DataArray, Floats, Group, Ints, MeshSource, distinct_tags
from hpcinv.physics.materials import MaterialLaw
from hpcinv.studies.second_opinion.regions import group_of

MOST_PARTS = 1000
"""Parts of a body. Raised, decks become slow to write and to read."""


@dataclasses.dataclass(frozen=True)
class Part:
    """Cells (rows) with one law and, where that is stated, one density (kg/m³)."""

    law: MaterialLaw
    cells: Ints
    density: float | None = None


@dataclasses.dataclass(frozen=True)
class CellValues:
    """Values of fields in the cells of a mesh.

    Attributes:
        data: arrays of the given mesh.
    """

    mesh: MeshSource
    data: Mapping[str, DataArray]
    job: Job

    def of(self, value: float | Field) -> Floats | None:
        """Return values (cells,), SI; ``None`` if a field varies within cells."""
        match value:
            case ByRegion():
                return self._regional(value)
            case ByData(array=name):
                array = self.data.get(name)
                return None if array is None or array.place != "cells" else array.values[:, 0] * value.factor
            case Field():
                return None
            case number:
                return np.full(len(self.mesh.cells), float(number))

    def _regional(self, value: ByRegion) -> Floats:
        """Return values where regions of the job take their cells from groups of the mesh, as in the run."""
        values = np.full(len(self.mesh.cells), value.numbers.get(ELSEWHERE, np.nan))
        for name in sorted(value.numbers, key=lambda name: name in self.job.regions):
            if name != ELSEWHERE:
                values[group_of(self.mesh, name, 3).members] = value.numbers[name]
        return values


def with_uniform_parts(
    laws: Mapping[str, MaterialLaw], density: Field | None, values: CellValues
) -> tuple[MeshSource, dict[str, MaterialLaw], dict[str, float]]:
    """Return the mesh with a group for each part that is not a region, and law and density by part.

    Laws that vary within cells, or in more than 1000 values, are left as they are.

    Args:
        laws: by region; the name of one for the whole body is empty.
        density: one that varies, kg/m³.

    Raises:
        OutputError: a density varies within cells.
    """
    mesh = values.mesh
    if density is not None and values.of(density) is None:
        raise OutputError("effects: a density varies within cells", "Decks have densities by region or by cell.")
    groups = list(mesh.groups)
    own_laws, densities = dict[str, MaterialLaw](), dict[str, float]()
    for region, law in laws.items():
        cells = group_of(mesh, region, 3).members if region else np.arange(len(mesh.cells))
        for number, part in enumerate(_parts(law, density, cells, values), 1):
            name = region if len(part.cells) == len(cells) else _named(groups, f"{region or 'part'}_{number}", part)
            own_laws[name] = part.law
            if part.density is not None:
                densities[name] = part.density
    if len(groups) == len(mesh.groups):
        return mesh, own_laws, densities
    return dataclasses.replace(mesh, groups=distinct_tags(groups)), own_laws, densities


def _parts(law: MaterialLaw, density: Field | None, cells: Ints, values: CellValues) -> Iterator[Part]:
    """Yield the parts of the cells of a law; all of them at once if it varies within cells."""
    quantities = {name: value for name, (value, _) in law.quantities().items()}
    fields = [entry for value in quantities.values() for entry in entries(value) if isinstance(entry, Field)]
    known = [values.of(field) for field in fields]
    if any(column is None for column in known):
        yield Part(law, cells)
        return
    columns = [
        column[cells] for column in [*known, *([] if density is None else [values.of(density)])] if column is not None
    ]
    if not columns:
        yield Part(law, cells)
        return
    rows, which = np.unique(np.stack(columns, axis=1), axis=0, return_inverse=True)
    if len(rows) > MOST_PARTS:
        yield Part(law, cells)
        return
    for number, row in enumerate(rows.tolist()):
        numbers = iter(row)
        changes = {name: with_numbers(value, numbers) for name, value in quantities.items() if _varies(value)}
        own = law.model_copy(update=changes) if changes else law
        yield Part(own, cells[which.ravel() == number], None if density is None else next(numbers))


def _varies(value: Any) -> bool:
    return any(isinstance(entry, Field) for entry in entries(value))


def with_numbers(value: Any, numbers: Iterator[float]) -> Any:
    """Return a quantity, or a tuple, with the next numbers instead of its fields."""
    if isinstance(value, tuple):
        return tuple(with_numbers(entry, numbers) for entry in value)
    return next(numbers) if isinstance(value, Field) else value


def _named(groups: list[Group], name: str, part: Part) -> str:
    """Return the name of the group of cells that a part is; add one if there is none."""
    for group in groups:
        if group.dim == 3 and np.array_equal(np.sort(group.members), np.sort(part.cells)):
            return group.name
    taken = {group.name for group in groups}
    while name in taken:
        name += "_part"
    groups.append(Group(name, 3, 0, np.sort(part.cells)))
    return name
