"""Layers of a body: regions in which its law, its parameters and its inelastic stretch are the same.

The pressure of a mixed form jumps where one layer meets another, so that each has pressures of its own there.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.expressions import LET
from hpcinv.base.quantity.spatial_fields import Field, fields_in
from hpcinv.job.sensitivities import Parameter, tied_parameters
from hpcinv.physics.effects import Effect
from hpcinv.physics.materials import MaterialLaw


@dataclass(frozen=True)
class Layering:
    """Classes of regions of cells; regions of one class are the same to a law or an effect.

    Attributes:
        classes: class of each region by its name, the first one 0.
        law: class of the laws to which it applies; ``None`` for the whole body.
    """

    classes: Mapping[str, int]
    law: int | None = None

    def as_data(self) -> list[Any]:
        """JSON data."""
        return [self.law, dict(self.classes)]


def _regional_numbers(owner: Ingredient, own: set[Any]) -> Iterator[tuple[tuple[str, ...], Sequence[Any]]]:
    """Yield regions of each regional field of a law or effect, and their numbers.

    Args:
        own: regions with numbers of their own, which are marked with the region.
    """
    for field in _fields(owner):
        if field.is_regional:
            numbers = [(number, region if region in own else "") for region, number in field.numbers.items()]
            yield tuple(field.numbers), numbers


def _fields(owner: Ingredient) -> Iterator[Field]:
    for value, _ in owner.quantities().values():
        yield from fields_in(value)


def layerings_of(
    laws: Mapping[str, MaterialLaw], effects: Mapping[str, Effect], varied: list[Parameter]
) -> tuple[Layering, ...]:
    """Return what divides a body into layers, the laws first; nothing if it is one.

    Args:
        laws: laws of all regions, by their keys in the job.
        effects: effects by their keys in the job.
        varied: numbers by which results are differentiated. Regions that have such numbers of their own are never the
            same, since they differ as soon as one of the numbers changes.
    """
    owners: list[tuple[str, Ingredient]] = [*laws.items(), *((w, e) for w, e in effects.items() if not e.is_load)]
    if len(laws) == 1 and not any(field.is_regional for _, owner in owners for field in _fields(owner)):
        return ()
    free = {(number.where, *number.place) for number in tied_parameters(varied)}
    law_layers = _classes({where: _text(law, where, free) for where, law in laws.items()})
    layerings = [
        Layering({where.removeprefix("material."): number for where, number in law_layers.items()}),
        *_regional_layerings(owners, law_layers, free),
    ]
    return tuple(layering for layering in layerings if max(layering.classes.values()) > 0)


def _regional_layerings(
    owners: Iterable[tuple[str, Ingredient]], law_layers: Mapping[str, int], free: set[tuple[Any, ...]]
) -> Iterator[Layering]:
    """Yield what values by region divide a body into; arguments as in `layerings_of`."""
    values: dict[tuple[int | None, tuple[str, ...]], list[Sequence[Any]]] = {}
    for where, owner in owners:
        own = {part for place in free if place[0] == where for part in place[1:]}
        for regions, numbers in _regional_numbers(owner, own):
            values.setdefault((law_layers.get(where), regions), []).append(numbers)
    for (law, regions), fields in values.items():
        yield Layering(_classes(dict(zip(regions, zip(*fields, strict=True), strict=True))), law)


def _text(law: MaterialLaw, where: str, free: set[tuple[Any, ...]]) -> str:
    """Return all of a law as text, with its place if one of its numbers is free."""
    own_place = [where] if any(owner == where for owner, *_ in free) else []
    return json.dumps([law.model_dump(mode="json", context={LET: True}), own_place], sort_keys=True)


def _classes(values: Mapping[str, Any]) -> dict[str, int]:
    """Return numbers that are the same where values are, in the order of their first appearance."""
    numbers: dict[Any, int] = {}
    return {name: numbers.setdefault(value, len(numbers)) for name, value in values.items()}
