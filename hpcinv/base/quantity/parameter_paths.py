"""Numbers in the quantities of laws and effects: their places, replacement, and derivatives by them."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from hpcinv.base.quantity.quantity import Measured
from hpcinv.base.quantity.schema import KeyPath
from hpcinv.base.quantity.spatial_fields import Field
from hpcinv.base.quantity.units import Dimension

POINTS = (-2, -1, 1, 2)
"""Points of `central_difference`, in steps."""
_STEP = 2.0**-12  # relative; its fourth power is below rounding


@dataclass(frozen=True)
class Number:
    """A number in SI and its dimension, ``None`` if that depends on its use in a formula."""

    value: float
    dimension: Dimension | None


def scalars(value: Any, place: KeyPath) -> Iterator[tuple[KeyPath, float | str]]:
    """Place and value (SI) of every number in a quantity; for other values a description as text."""
    match value:
        case None:
            return
        case tuple():
            for i, entry in enumerate(value):
                yield from scalars(entry, (*place, i))
        case Field() if value.is_regional:
            for region, entry in value.numbers.items():
                yield (*place, region), entry
        case Field():
            yield place, f"varies over the body ({value.plain()}), and is not a number"
        case _:
            yield place, float(value) if math.isfinite(value) else "is infinite"


def replace_scalar(value: Any, place: KeyPath, number: float) -> Any:
    """Copy of a quantity with another number at a place in it."""
    if not place:
        return replace(value, value=number) if isinstance(value, Measured) else number
    here, rest = place[0], place[1:]
    match value:
        case Field():
            return replace(value, numbers={**value.numbers, str(here): number})
        case Mapping():
            return {**value, here: replace_scalar(value[here], rest, number)}
        case _:
            return tuple(replace_scalar(v, rest, number) if i == here else v for i, v in enumerate(value))


def rate(function: Callable[[float], Any], value: float) -> Any:
    """Derivative of quantities ``of(number)``, in the same structure; for a formula, derivatives of its constants.

    By central differences of fourth order: exact (0 or 1) for a constant or the number itself, otherwise to about
    1e-12.
    """
    step = step_at(value)
    points = [value + k * step for k in POINTS]
    return _rate(points, [function(point) for point in points], step)


def step_at(number: float) -> float:
    """Step of the central differences at a number."""
    return _STEP * abs(number) or _STEP


def central_difference(values: Iterable[Any], step: float) -> Any:
    """Derivative of fourth order from the values (numbers or arrays) at `POINTS`."""
    a, b, c, d = values
    return (a - 8 * b + 8 * c - d) / (12 * step)


def _rate(points: list[float], values: list[Any], step: float) -> Any:
    first = values[0]
    match first:
        case tuple():
            return tuple(_rate(points, list(entries), step) for entries in zip(*values, strict=True))
        case dict():
            return {name: _rate(points, [v[name] for v in values], step) for name in first}
        case Field():
            return replace(first, numbers=_rate(points, [dict(v.numbers) for v in values], step))
    if all(v == first for v in values):
        return 0.0
    if values == points:
        return 1.0
    return central_difference(values, step)


def vanishes(derivatives: Any) -> bool:
    """Return whether a result of `rate` is zero everywhere."""
    match derivatives:
        case tuple():
            return all(map(vanishes, derivatives))
        case Field():
            return all(map(vanishes, derivatives.numbers.values()))
        case _:
            return bool(derivatives == 0.0)
