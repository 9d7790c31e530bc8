"""References of the sections of a job to regions, each with its place in the section."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.schema import KeyPath
from hpcinv.base.quantity.spatial_fields import ELSEWHERE, fields_in
from hpcinv.job.cavities import Cavity
from hpcinv.job.fibres import FibreFamily
from hpcinv.job.interfaces import Interface
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.job.region_rules import EXCEPT, RegionRule, RegionUnion
from hpcinv.job.support import Support
from hpcinv.physics.effects import Effect
from hpcinv.physics.materials import MaterialLaw

type References = Iterator[tuple[KeyPath, str]]


def union_members(regions: Mapping[str, RegionRule]) -> References:
    for name, rule in regions.items():
        for i, entry in enumerate(rule.entries if isinstance(rule, RegionUnion) else ()):
            yield ("regions", name, i), entry.removeprefix(EXCEPT).strip()


def loading_regions(supports: Sequence[Support], effects: Sequence[Effect]) -> References:
    """Yield the references of supports and effects, of the job or of one of its states."""
    for i, support in enumerate(supports):
        yield ("supports", i, "region"), support.region
    for i, effect in enumerate(effects):
        for name, field in effect.surfaces.items():
            yield ("effects", i, field), name
        yield from _value_regions(effect, ("effects", i))


def law_regions(laws: Mapping[str, MaterialLaw]) -> References:
    for where, law in laws.items():
        if (region := where.partition(".")[2]) and region != ELSEWHERE:
            yield ("material", region), region
        yield from _value_regions(law, tuple(where.split(".", 1)))


def fibre_regions(fibres: Mapping[str, FibreFamily]) -> References:
    for name, family in fibres.items():
        for field, region in family.rule.surfaces.items() if family.rule is not None else ():
            yield ("fibres", name, "rule", field), region


def cavity_regions(cavities: Mapping[str, Cavity]) -> References:
    for name, cavity in cavities.items():
        for region in cavity.surface:
            yield ("cavities", name, "surface"), region
        if cavity.lid_region is not None:
            yield ("cavities", name, "lid", "region"), cavity.lid_region


def interface_regions(interfaces: Sequence[Interface]) -> References:
    for i, interface in enumerate(interfaces):
        for k, name in enumerate(interface.between):
            yield ("interfaces", i, "between", k), name


def known_regions(job: Any) -> References:
    """Yield the references of what is known of contacts, of interfaces and on obstacles."""
    for section in ("interfaces", "effects"):
        for i, entry in enumerate(getattr(job, section)):
            known = getattr(entry, "known", None)
            if known is not None and known.rest_surface is not None:
                yield (section, i, "known", "rest_surface", "region"), known.rest_surface.region


def quantity_regions(quantities: Sequence[QuantityOfInterest]) -> References:
    for i, quantity in enumerate(quantities):
        if quantity.on is not None:
            yield ("quantities", i, "on"), quantity.on


def _value_regions(owner: Ingredient, place: KeyPath) -> References:
    """Yield the regions in values by region, which are keys."""
    for key in type(owner).model_fields:
        if fields := fields_in(getattr(owner, key)):
            for name in dict.fromkeys(name for field in fields if field.is_regional for name in field.numbers):
                if name != ELSEWHERE:
                    yield (*place, key, name), name


def _state_regions(job: Any) -> References:
    for i, state in enumerate(job.states):
        for place, name in loading_regions(state.supports or (), state.effects):
            yield ("states", i, *place), name


REFERENCES: tuple[Callable[[Any], References], ...] = (
    lambda job: union_members(job.regions),
    lambda job: loading_regions(job.supports, job.effects),
    _state_regions,
    lambda job: law_regions(job.laws),
    lambda job: fibre_regions(job.fibres),
    lambda job: cavity_regions(job.cavities),
    lambda job: interface_regions(job.interfaces),
    known_regions,
    lambda job: quantity_regions(job.quantities),
)
"""references of a job to regions, in the order in which faults are reported"""
