"""Parameters of the cases of a sweep as columns of numbers in SI, or of text."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

from hpcinv.base.quantity.constants import constant
from hpcinv.base.quantity.units import Dimension, as_float
from hpcinv.studies.batch.axes import Axis
from hpcinv.studies.batch.specification import text_of
from hpcinv.studies.sweep.sweep_plan import SweepPlan


def parameter_columns(plan: SweepPlan) -> dict[str, list[Any]]:
    """Return a column with a value for each case, by key or name of branches.

    It has numbers if all values are numbers or quantities, ``None`` in cases without this parameter; else text, empty
    there.
    """
    parameters = [*plan.cases.parameters]
    keys = dict.fromkeys(key for values in parameters for key in values)
    return {key: _column([values.get(key) for values in parameters]) for key in keys}


def parameter_units(plan: SweepPlan) -> dict[str, str]:
    """Return the SI units of the parameters that have units in the file."""
    dimensions_by_key = {}
    for axis in _axes(plan.sweep.axes):
        for key, distribution in axis.sample.items():
            dimensions_by_key[key] = distribution.dimension
        for key, values in (axis.grid or axis.zip or {}).items():
            dimensions = [_parsed(value)[1] for value in values]
            dimensions_by_key[key] = next((dimension for dimension in dimensions if dimension is not None), None)
    return {key: dimension.unit for key, dimension in dimensions_by_key.items() if dimension is not None}


def log_uniform(plan: SweepPlan) -> set[str]:
    """Return the keys that are sampled uniformly in their logarithm."""
    return {k for axis in _axes(plan.sweep.axes) for k, d in axis.sample.items() if d.kind == "log-uniform"}


def sampled(plan: SweepPlan) -> set[str]:
    return {key for axis in _axes(plan.sweep.axes) for key in axis.sample}


def _axes(axes: Sequence[Axis]) -> Iterator[Axis]:
    """Yield all axes, also those in branches."""
    for axis in axes:
        yield axis
        for branch in (axis.branches or {}).values():
            yield from _axes(branch.axes)


def _column(values: list[Any]) -> list[Any]:
    numbers = [_parsed(value)[0] for value in values]
    if all(n is not None for n, value in zip(numbers, values, strict=True) if value is not None):
        return numbers
    return ["" if value is None else text_of(value) for value in values]


def _parsed(value: Any) -> tuple[float | None, Dimension | None]:
    """Return the number (SI) of a value, ``None`` if it is none, and its dimension if it has a unit."""
    if isinstance(value, str):
        try:
            number, dimension = constant(value)
        except ValueError:
            return None, None
        return number, dimension
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None, None
    return (value if isinstance(value, float) else as_float(value) if abs(value) > 2**53 else value), None
