"""Points of axes by their number: each is made when it is asked for, so that a million take little memory."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any, NamedTuple, overload

from hpcinv.studies.batch.axes import Axis
from hpcinv.studies.batch.sampling import unit_points


class AxisPoint(NamedTuple):
    """A point of one axis, or of several that are combined.

    Attributes:
        parameters: what identifies the point: values by key, and labels of branches by the name of their axis.
        settings: values by key in the job.
    """

    parameters: Mapping[str, Any]
    settings: Mapping[str, Any]


class _Points(Sequence[AxisPoint]):
    """Points by number."""

    @overload
    def __getitem__(self, number: int) -> AxisPoint: ...

    @overload
    def __getitem__(self, number: slice) -> Sequence[AxisPoint]: ...

    def __getitem__(self, number: int | slice) -> AxisPoint | Sequence[AxisPoint]:
        if isinstance(number, slice):
            return [self._point(n) for n in range(*number.indices(len(self)))]
        if not 0 <= number < len(self):
            raise IndexError(number)
        return self._point(number)

    def _point(self, number: int) -> AxisPoint:
        raise NotImplementedError


class CombinedPoints(_Points):
    """Every combination of the points of axes, the last axis changing fastest; without axes one point."""

    def __init__(self, axes: Sequence[Axis]) -> None:
        self._axes = [_points_of(axis) for axis in axes]
        self._counts = [len(points) for points in self._axes]
        self._count = math.prod(self._counts)

    def __len__(self) -> int:
        return self._count

    def _point(self, number: int) -> AxisPoint:
        points = [axis._point(i) for axis, i in zip(self._axes, _places(number, self._counts), strict=True)]
        if len(points) == 1:
            return points[0]
        return AxisPoint(
            {key: value for point in points for key, value in point.parameters.items()},
            {key: value for point in points for key, value in point.settings.items()},
        )


class _Branches(_Points):
    """Points of the branches of an axis, one branch after the other."""

    def __init__(self, axis: Axis) -> None:
        self._name, branches = axis.name, axis.branches or {}
        self._branches = [(label, branch.set, CombinedPoints(branch.axes)) for label, branch in branches.items()]
        self._ends = list(accumulate(len(points) for _, _, points in self._branches))

    def __len__(self) -> int:
        return self._ends[-1]

    def _point(self, number: int) -> AxisPoint:
        place = bisect_right(self._ends, number)
        label, common, points = self._branches[place]
        parameters, settings = points._point(number - (self._ends[place - 1] if place else 0))
        return AxisPoint({self._name: label, **parameters}, {**common, **settings})


class _Grid(_Points):
    """Every combination of values by key, the last key changing fastest."""

    def __init__(self, values: Mapping[str, Sequence[Any]]) -> None:
        self._values, self._counts = values, [len(entries) for entries in values.values()]

    def __len__(self) -> int:
        return math.prod(self._counts)

    def _point(self, number: int) -> AxisPoint:
        places = zip(self._values.items(), _places(number, self._counts), strict=True)
        values = {key: entries[i] for (key, entries), i in places}
        return AxisPoint(values, values)


class _Rows(_Points):
    """Values by key that are taken in parallel."""

    def __init__(self, values: Mapping[str, Sequence[Any]]) -> None:
        self._values = values

    def __len__(self) -> int:
        return len(next(iter(self._values.values())))

    def _point(self, number: int) -> AxisPoint:
        values = {key: entries[number] for key, entries in self._values.items()}
        return AxisPoint(values, values)


class _Sample(_Points):
    """Sampled values by key."""

    def __init__(self, axis: Axis) -> None:
        self._distributions, count = axis.sample, axis.count or 0
        self._shares = unit_points(axis.sampling, len(axis.sample), count, axis.seed)

    def __len__(self) -> int:
        return len(self._shares)

    def _point(self, number: int) -> AxisPoint:
        drawn = zip(self._distributions.items(), self._shares[number], strict=True)
        values = {key: distribution.quantile(share) for (key, distribution), share in drawn}
        return AxisPoint(values, values)


def _points_of(axis: Axis) -> _Points:
    if axis.branches is not None:
        return _Branches(axis)
    if axis.grid is not None:
        return _Grid(axis.grid)
    return _Sample(axis) if axis.zip is None else _Rows(axis.zip)


def _places(number: int, counts: Sequence[int]) -> list[int]:
    """Return the digits of a number, the last one changing fastest; ``counts`` of values of each."""
    places = []
    for count in reversed(counts):
        number, place = divmod(number, count)
        places.append(place)
    return places[::-1]
