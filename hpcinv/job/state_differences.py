"""Quantities between two states: the value in one state less the value in another, at the same material points."""

from collections.abc import Iterable, Mapping
from typing import Any

from hpcinv.job.quantity_of_interest import QuantityOfInterest


def parts(quantity: QuantityOfInterest) -> tuple[QuantityOfInterest, ...]:
    """Return a quantity by itself, or the quantity in each of the two states whose difference it is."""
    if quantity.from_state is None:
        return (quantity,)
    return tuple(
        quantity.model_copy(update={"name": f"{quantity.name} in {state}", "state": state, "from_state": None})
        for state in (quantity.state, quantity.from_state)
    )


def quantities_in(quantities: Iterable[QuantityOfInterest], state: str) -> tuple[QuantityOfInterest, ...]:
    """Return what is evaluated in one state."""
    return tuple(part for quantity in quantities for part in parts(quantity) if part.state == state)


def with_differences(quantities: Iterable[QuantityOfInterest], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by the names of quantities, where all parts are known.

    Args:
        values: numbers, vectors, or mappings of such, by the names of the parts.
    """
    known: dict[str, Any] = {}
    for quantity in quantities:
        names = [part.name for part in parts(quantity)]
        if all(name in values for name in names):
            first, *others = (values[name] for name in names)
            known[quantity.name] = _less(first, others[0]) if others else first
    return known


def _less(value: Any, other: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _less(value[key], other[key]) for key in value}
    if isinstance(value, list):
        return [a - b for a, b in zip(value, other, strict=True)]
    return value - other
