"""Regions by the values of an integer array in the cells, surface cells or nodes of a mesh."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.errors import MeshError
from hpcinv.job.mesh_section import ArrayLabels
from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.facet_groups import add_facets, facets_and_cells_inside, join_facets
from hpcinv.mesh.source import DataArray, Group, Ints, MeshSource, distinct_tags
from hpcinv.mesh.topology import FacetTable

_MOST_VALUES = 1000
"""values of an array that makes regions; raised, an array of numbers of cells makes a region for each of them"""
_SHOWN = 12
"""values of an array in a message; raised, messages are longer than two lines"""


def add_label_groups(source: MeshSource, labels: ArrayLabels) -> MeshSource:
    """Return a mesh with a group for each value of an array, or for the values of each name.

    Values without a name are groups such as ``material-2``. A value in nodes has the boundary facets and the cells all
    of whose vertices have it.

    Raises:
        MeshError: there is no such array of integers, or a value of a name does not occur.
    """
    where = f"{source.path}: mesh.labels"
    arrays = _arrays(source)
    if labels.array not in {*source.data, *arrays}:
        hint = did_you_mean(labels.array, arrays, list_all=False)
        raise MeshError(f"{where}: the mesh has no array '{labels.array}'.{hint}", _listed(source))
    if labels.array not in arrays:
        raise MeshError(f"{where}: the array '{labels.array}' does not have integers", _listed(source))
    places = arrays[labels.array]
    distinct = np.unique(np.concatenate([*places.values()]))
    if len(distinct) > _MOST_VALUES:
        text = f"the array '{labels.array}' has {len(distinct):,} values; regions can have {_MOST_VALUES:,}"
        raise MeshError(f"{where}: {text}", _listed(source))
    for name, named in labels.names.items():
        if missing := [n for n in named if n not in distinct]:
            text = f"no {' or '.join(places)} of the mesh have the value {missing[0]} of '{labels.array}'"
            raise MeshError(f"{where}.names.{name}: {text}", f"Its values are {_shown(distinct)}.")
    numbers: dict[str, Sequence[int]] = dict(labels.names)
    named_values = {n for named in numbers.values() for n in named}
    numbers |= {f"{labels.array}-{n}": [n] for n in distinct.tolist() if n not in named_values}
    earlier = len(source.groups)
    return _without_repeated(_labelled(source, places, numbers, labels), earlier, where)


def _labelled(
    source: MeshSource, places: Mapping[str, Ints], numbers: Mapping[str, Sequence[int]], labels: ArrayLabels
) -> MeshSource:
    """Return a mesh with further groups, of values by their names."""
    if "nodes" in places:
        return _by_nodes(source, places["nodes"], numbers, labels)
    if "cells" in places:
        source = _with_groups(source, 3, places["cells"], numbers)
    if "surface cells" in places and source.surface_cells is not None:
        count = len(source.facets)
        source = dataclasses.replace(source, facets=np.concatenate([source.facets, source.surface_cells.nodes]))
        unnamed = min(min(named) for named in numbers.values()) - 1
        rows = np.concatenate([np.full(count, unnamed), places["surface cells"]])
        source = _drop_ungrouped(_with_groups(source, 2, rows, numbers))
    return source


def _without_repeated(source: MeshSource, earlier: int, where: str) -> MeshSource:
    """Return a mesh without the groups that the file has as well, such as a shape file written of this mesh.

    Args:
        earlier: number of the first groups, which the file has.

    Raises:
        MeshError: a group of the file has the same name and other members.
    """
    own, labelled = _members(source.groups[:earlier]), _members(source.groups[earlier:])
    repeated = own.keys() & labelled.keys()
    for name in sorted(repeated):
        if own[name] != labelled[name]:
            raise MeshError(
                f"{where}: the mesh has a group '{name}' already, with other members",
                f"Choose another name for its values in mesh.labels.names, or remove '{name}' from the file.",
            )
    new = [group for group in source.groups[earlier:] if group.name not in repeated]
    return dataclasses.replace(source, groups=(*source.groups[:earlier], *new))


def _members(groups: Sequence[Group]) -> dict[str, dict[int, set[int]]]:
    """Return the members of groups by name and dimension."""
    members = dict[str, dict[int, set[int]]]()
    for group in groups:
        members.setdefault(group.name, {})[group.dim] = set(group.members.tolist())
    return members


def _with_groups(source: MeshSource, dim: int, values: Ints, numbers: Mapping[str, Sequence[int]]) -> MeshSource:
    groups = [
        Group(name, dim, max(named[0], 0), np.flatnonzero(np.isin(values, named))) for name, named in numbers.items()
    ]
    kept = [group for group in groups if len(group.members)]
    return dataclasses.replace(source, groups=distinct_tags([*source.groups, *kept]))


def _drop_ungrouped(source: MeshSource) -> MeshSource:
    """Return the mesh without facets that are not in a group, each facet once."""
    kept = np.flatnonzero(source.labels(2) >= 0)
    groups = (
        dataclasses.replace(g, members=np.searchsorted(kept, g.members)) if g.dim == 2 else g for g in source.groups
    )
    return join_facets(dataclasses.replace(source, facets=source.facets[kept], groups=tuple(groups)))


def _by_nodes(
    source: MeshSource, values: Ints, numbers: Mapping[str, Sequence[int]], labels: ArrayLabels
) -> MeshSource:
    vertices = source.cells[:, : vertex_count(source.kind)]
    table = FacetTable.build(source.kind, vertices)
    sides, groups = dict[str, Ints](), list(source.groups)
    for name, named in numbers.items():
        facets, cells = facets_and_cells_inside(table, vertices, np.isin(values, named))
        if len(facets):
            sides[name] = table.owners(facets)
        if len(cells):
            groups.append(Group(name, 3, max(named[0], 0), cells))
        if name in labels.names and not len(cells) and not len(facets):
            raise MeshError(
                f"{source.path}: mesh.labels.names.{name}: is not at all vertices of any cell or boundary facet",
                "Give all vertices of a facet or cell the value.",
            )
    return add_facets(dataclasses.replace(source, groups=distinct_tags(groups)), sides)


def integer_arrays(source: MeshSource) -> Iterator[str]:
    """Yield names and values of the arrays of a mesh that can be regions."""
    for name, places in sorted(_arrays(source).items(), key=lambda entry: ("cells" not in entry[1], entry[0])):
        distinct = np.unique(np.concatenate([*places.values()]))
        if len(distinct) <= _MOST_VALUES:
            yield f"{name} (in {' and '.join(places)}: {_shown(distinct)})"


def _arrays(source: MeshSource) -> dict[str, dict[str, Ints]]:
    """Integers by name of the array and place: nodes, cells, surface cells."""
    arrays = {
        array.name: {str(array.place): v} for array in source.data.values() if (v := _integers(array)) is not None
    }
    if source.surface_cells is not None:
        for name, values in source.surface_cells.values.items():
            if "nodes" not in arrays.get(name, {}):
                arrays.setdefault(name, {})["surface cells"] = values
    return arrays


def _integers(array: DataArray) -> Ints | None:
    values = array.values
    with np.errstate(invalid="ignore"):
        is_whole = values.shape[1] == 1 and len(values) > 0 and bool((np.abs(values) < _LARGEST).all())
        return values[:, 0].astype(np.int64) if is_whole and (values == np.rint(values)).all() else None


_LARGEST = 2.0**53
"""integers up to which doubles have all; raised, different labels are one"""


def _shown(values: npt.NDArray[np.int64]) -> str:
    return ", ".join(map(str, values[:_SHOWN].tolist())) + (", …" if len(values) > _SHOWN else "")


def _listed(source: MeshSource) -> str:
    arrays = "; ".join(integer_arrays(source))
    return f"Arrays of integers: {arrays or 'none'}."
