"""Expansion of axes to the points that they combine to."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from hpcinv.batch.axes import SAMPLES, Axis
from hpcinv.batch.sampling import unit_points
from hpcinv.quantity.keys import parse_key


class Point(NamedTuple):
    """A point of one axis, or of several that are combined.

    Attributes:
        parameters: what identifies the point: values by key, and labels of branches by the name of their axis.
        settings: values by key in the job.
    """

    parameters: Mapping[str, Any]
    settings: Mapping[str, Any]


def combined(axes: Sequence[Axis]) -> Iterator[Point]:
    """Yield every combination of the points of axes, the last axis changing fastest; without axes one point."""
    for points in itertools.product(*(list(_points(axis)) for axis in axes)):
        yield Point(
            {key: value for point in points for key, value in point.parameters.items()},
            {key: value for point in points for key, value in point.settings.items()},
        )


def sections_first(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings in the order in which they must be set: whole sections before values in them."""
    return dict(sorted(settings.items(), key=lambda setting: len(parse_key(setting[0]))))


def _points(axis: Axis) -> Iterator[Point]:
    if axis.branches is not None:
        for label, branch in axis.branches.items():
            for parameters, settings in combined(branch.axes):
                yield Point({axis.name: label, **parameters}, {**branch.set, **settings})
    else:
        for values in _values(axis):
            yield Point(values, values)


def _values(axis: Axis) -> Iterator[dict[str, Any]]:
    """Yield the values by key of each point of an axis that has no branches."""
    if axis.grid is not None:
        for combination in itertools.product(*axis.grid.values()):
            yield dict(zip(axis.grid, combination, strict=True))
    elif axis.zip is not None:
        for row in zip(*axis.zip.values(), strict=True):
            yield dict(zip(axis.zip, row, strict=True))
    else:
        method = next(method for method in SAMPLES if axis.kind == method)
        for shares in unit_points(method, len(axis.sample), axis.count or 0, axis.seed):
            drawn = zip(axis.sample.items(), shares, strict=True)
            yield {key: distribution.quantile(share) for (key, distribution), share in drawn}
