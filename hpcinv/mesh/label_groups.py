"""Regions by the values of an integer array in the cells of a mesh."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from hpcinv.errors import MeshError
from hpcinv.job.sections import ArrayLabels
from hpcinv.mesh.source import DataArray, Group, Ints, MeshSource, distinct_tags
from hpcinv.quantity.suggestions import did_you_mean

_MOST_VALUES = 1000
"""Regions of an array; raised, an array of numbers of cells makes a region for each of them."""
_SHOWN = 12


def add_label_groups(source: MeshSource, labels: ArrayLabels) -> MeshSource:
    """Return a mesh with a group of cells for each value of an array, or for the values of each name.

    Values without a name are groups such as ``material-2``.

    Raises:
        MeshError: there is no such array of integers, or a value of a name does not occur.
    """
    array = source.data.get(labels.array)
    if array is None:
        hint = did_you_mean(labels.array, source.data, list_all=False)
        raise MeshError(f"{source.path}: has no array '{labels.array}'.{hint}", _listed(source))
    values = _integers(array)
    if values is None or array.place != "cells":
        raise MeshError(
            f"{source.path}: the array '{labels.array}' does not have integers in the cells", _listed(source)
        )
    distinct = np.unique(values)
    if len(distinct) > _MOST_VALUES:
        text = f"has {len(distinct):,} values; regions can have {_MOST_VALUES:,}"
        raise MeshError(f"{source.path}: the array '{labels.array}' {text}", _listed(source))
    numbers = {name: [int(n) for n in named] for name, named in labels.names.items()}
    for name, named in numbers.items():
        if missing := [n for n in named if n not in distinct]:
            text = f"labels.names.{name}: no cell has the value {missing[0]} of '{labels.array}'"
            raise MeshError(f"{source.path}: {text}", f"Its values are {_shown(distinct)}.")
    others = [int(n) for n in distinct if not any(n in named for named in numbers.values())]
    numbers |= {f"{labels.array}-{n}": [n] for n in others}
    groups = [
        Group(name, 3, max(named[0], 0), np.flatnonzero(np.isin(values, named))) for name, named in numbers.items()
    ]
    return dataclasses.replace(source, groups=distinct_tags([*source.groups, *groups]))


def integer_arrays(source: MeshSource) -> Iterator[str]:
    """Yield names and values of the arrays of a mesh that can be regions."""
    for array in source.data.values():
        values = _integers(array)
        if array.place == "cells" and values is not None and len(distinct := np.unique(values)) <= _MOST_VALUES:
            yield f"{array.name} ({_shown(distinct)})"


def _integers(array: DataArray) -> Ints | None:
    values = array.values
    if values.shape[1] != 1 or not len(values) or not (values == np.rint(values)).all():
        return None
    return np.asarray(values[:, 0].astype(np.int64))


def _shown(values: Ints) -> str:
    return ", ".join(map(str, values[:_SHOWN].tolist())) + (", …" if len(values) > _SHOWN else "")


def _listed(source: MeshSource) -> str:
    arrays = "; ".join(integer_arrays(source))
    return f"Arrays of integers in its cells, with their values: {arrays or 'none'}."
