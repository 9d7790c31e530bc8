"""The section ``sensitivities`` of a job: numbers of laws, effects, … by key, and how uncertain they are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hpcinv.quantity.keys import parse_key
from hpcinv.quantity.quantity import Quantity
from hpcinv.quantity.schema import Location, at, shown
from hpcinv.quantity.suggestions import did_you_mean
from hpcinv.quantity.units import Dimension, parse_quantity

if TYPE_CHECKING:
    from hpcinv.job.sections import Support
    from hpcinv.quantity.component import Ingredient

_DEVIATION = Quantity(None, above=0.0)


type Owner = Ingredient | Support


@dataclass(frozen=True)
class Parameter:
    """A number of a job by which its results are differentiated.

    Attributes:
        key: its key in the job.
        where: key of what it belongs to.
        owner: law, effect, family of fibres or support.
        place: its place in there.
        value: in SI.
        deviation: its standard deviation in SI, ``None`` if none is given.
    """

    key: str
    where: str
    owner: Owner
    place: Location
    value: float
    dimension: Dimension | None
    deviation: float | None = None


def read_sensitivities(
    given: object, owners: Mapping[str, Owner]
) -> tuple[dict[str, float | None], list[tuple[Location, str]]]:
    """Standard deviations (SI, ``None`` if there is none) by key, and what is wrong with those that are ``given``.

    Args:
        owners: laws, effects, the families of fibres that these need, and supports, by their keys in the job.
    """
    if not isinstance(given, Mapping | list | tuple):
        text = f"must be a list of keys, or a mapping of keys to standard deviations, not {shown(given)}"
        return {}, [((), text)]
    entries: list[tuple[int | str, object, object]]
    if isinstance(given, Mapping):
        entries = [(str(key), key, deviation) for key, deviation in given.items()]
    else:
        entries = [(i, key, None) for i, key in enumerate(given)]
    found: dict[str, float | None] = {}
    problems: list[tuple[Location, str]] = []
    for place, key, deviation in entries:
        try:
            if not isinstance(key, str):
                raise ValueError(f"must be a key such as material.mu, not {shown(key)}")
            if key in found:
                raise ValueError(f"{key} is there already")
            number = parameter(key, owners, None)
            found[key] = None if deviation is None else _deviation(deviation, number)
        except ValueError as error:
            problems.append(((place,), str(error)))
    return found, problems


def parameter(key: str, owners: Mapping[str, Owner], deviation: float | None) -> Parameter:
    """What a key means; ``ValueError`` if it is no number of one of these."""
    location, known = tuple(parse_key(key)), dict[Location, str]()
    for where, owner in owners.items():
        begin = _location(where)
        for place, number in owner.numbers().items():
            if (*begin, *place) == location:
                if isinstance(number, str):
                    raise ValueError(f"{key} {number}: there is no derivative by it")
                return Parameter(key, where, owner, place, number.value, number.dimension, deviation)
            if not isinstance(number, str):
                known[(*begin, *place)] = at((*begin, *place))
    if inside := [name for place, name in known.items() if place[: len(location)] == location]:
        raise ValueError(f"{key} is not one number; take {' or '.join(_first(inside))}")
    hint = did_you_mean(key, known.values(), list_all=False) or f" Such are {', '.join(_first(known.values()))}."
    raise ValueError(f"{key} is no number of a law, an effect, fibres or a support in this job.{hint}")


def _location(where: str) -> Location:
    """``effects[0]``, ``material.REGION`` and ``fibres.NAME`` as places in a job."""
    section, bracket, number = where.partition("[")
    return (section, int(number.removesuffix("]"))) if bracket else tuple(where.split(".", 1))


def _first(names: Iterable[str]) -> list[str]:
    """The first few."""
    listed = list(names)
    return listed[:4] + (["…"] if len(listed) > 4 else [])


def _deviation(given: object, parameter: Parameter) -> float:
    """A standard deviation in SI; a plain number is."""
    value = _DEVIATION.parse(given)
    wanted = parameter.dimension
    if isinstance(given, str) and wanted is not None and (dimension := parse_quantity(given)[1]) != wanted:
        raise ValueError(f"must be {wanted}, as {parameter.key} is, but '{given}' is {dimension}")
    return value
