"""Loads of a surface that have one value in each cell, as one load for each value: decks have no fields."""

from __future__ import annotations

import dataclasses

import numpy as np

from hpcinv.base.quantity.spatial_fields import Field, entries
from hpcinv.formats.readers.elements import elements_of, faces_of
from hpcinv.job.body_kinds import SOLID
from hpcinv.mesh.source import Group, MeshSource, distinct_tags
from hpcinv.physics.effects import Effect
from hpcinv.studies.second_opinion.regions import group_of
from hpcinv.studies.second_opinion.uniform_parts import MOST_PARTS, CellValues, with_numbers


def uniform_loads(effect: Effect, mesh: MeshSource, values: CellValues) -> tuple[MeshSource, list[Effect]]:
    """Return the mesh with a region for each value of a load on a surface, and the loads on these.

    The effect itself remains if it is uniform, varies within cells or in more than 1000 values, or is not on a surface
    of a solid.
    """
    quantities = {name: value for name, (value, _) in effect.quantities().items()}
    fields = [entry for value in quantities.values() for entry in entries(value) if isinstance(entry, Field)]
    region = getattr(effect, "region", None)
    known = [column for column in map(values.of, fields) if column is not None]
    if not fields or len(known) < len(fields) or region is None or mesh.body_kind != SOLID.name:
        return mesh, [effect]
    group = group_of(mesh, region)
    owners = np.array([cell for cell, _ in faces_of(mesh, group, elements_of(mesh))], dtype=np.int64)
    rows, which = np.unique(np.stack(known, axis=1)[owners], axis=0, return_inverse=True)
    if len(rows) > MOST_PARTS:
        return mesh, [effect]
    taken, groups, loads = {own.name for own in mesh.groups}, list(mesh.groups), list[Effect]()
    for number, row in enumerate(rows.tolist()):
        name = f"{region}_{number + 1}" if len(rows) > 1 else region
        while name in taken and len(rows) > 1:
            name += "_part"
        if len(rows) > 1:
            groups.append(Group(name, 2, 0, group.members[which.ravel() == number]))
        numbers = iter(row)
        changes = {key: with_numbers(value, numbers) for key, value in quantities.items()}
        loads.append(effect.model_copy(update={**changes, "region": name}))
    return dataclasses.replace(mesh, groups=distinct_tags(groups)), loads
