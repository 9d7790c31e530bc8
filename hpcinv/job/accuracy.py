"""The section ``accuracy`` of a job: how large the error of a quantity of interest may be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from hpcinv.job.sections import FIELDS, LENGTH, POSITIONS
from hpcinv.quantity.quantity import Quantity
from hpcinv.quantity.schema import Location, shown
from hpcinv.quantity.suggestions import did_you_mean
from hpcinv.quantity.units import Dimension, parse_quantity

if TYPE_CHECKING:
    from hpcinv.job.sections import QuantityOfInterest

_DEMAND = Quantity(None, above=0.0)


def read_demands(
    given: object, quantities: Sequence[QuantityOfInterest]
) -> tuple[dict[str, float], list[tuple[Location, str]]]:
    """Largest errors (SI) by the names of quantities, and what is wrong with those that are ``given``.

    That of a displacement is the length of its error.
    """
    if not isinstance(given, Mapping):
        return {}, [((), f"must be a mapping of names of quantities to their largest errors, not {shown(given)}")]
    known = {q.name: q for q in quantities}
    demands: dict[str, float] = {}
    problems: list[tuple[Location, str]] = []
    for name, value in given.items():
        if name not in known:
            fault = f"there is no such quantity in 'quantities'.{did_you_mean(str(name), known)}"
            problems.append(((str(name),), fault))
            continue
        if known[name].is_reaction:
            fault = "is a reaction, which has no error estimate; a demand can be on any other kind of quantity"
            problems.append(((name,), fault))
            continue
        try:
            demands[name] = _DEMAND.parse(value)
            _check_dimension(value, _dimension_of(known[name]))
        except ValueError as error:
            problems.append(((name,), str(error)))
    return demands, problems


def _dimension_of(quantity: QuantityOfInterest) -> Dimension | None:
    """``None`` where it may be any."""
    if quantity.is_displacement:
        return LENGTH
    found = quantity.of.check(POSITIONS | FIELDS)
    # An integral's depends on whether the region is a volume or a surface, which the mesh tells.
    return found if isinstance(found, Dimension) and quantity.reduce != "integral" else None


def _check_dimension(value: object, wanted: Dimension | None) -> None:
    """A plain number is in SI, and fits any quantity."""
    if isinstance(value, str) and wanted is not None:
        _, found = parse_quantity(value)
        if found != wanted:
            raise ValueError(f"must be {wanted}, as the quantity is, but '{value}' is {found}")
