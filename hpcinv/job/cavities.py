"""Section of a job file with cavities: hollows of the body whose volume is a quantity."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo

from hpcinv.base.quantity.parameter_paths import Number
from hpcinv.base.quantity.quantity import Length, Quantity, quantities_of
from hpcinv.base.quantity.schema import Faults, KeyPath, Spec, TextOrTexts, Triple
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.job.state_differences import parts
from hpcinv.job.states import VOLUME, StateSpec
from hpcinv.job.vocabulary import STRESS
from hpcinv.physics.effects.effect import Effect
from hpcinv.physics.effects.pressure import Pressure


class Lid(Spec):
    """Surface that closes the openings of a cavity instead of planes."""

    alternatives = ("region", "apex")

    region: str | None = None
    """region of the boundary that closes the cavity with its surface; openings that remain are closed by planes"""
    apex: Triple[Length] | None = None
    """fixed point to which straight lines close each opening: of half, quarter or eighth bodies a point on all planes
    of symmetry"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if (self.region is None) == (self.apex is None):
            yield (), "needs exactly one of 'region' and 'apex'"


class Gas(Spec):
    """A gas that fills a cavity: pressure times volume is in proportion to its amount times its temperature."""

    ambient: Annotated[float, Quantity("Pa", above=0.0)]
    """absolute pressure around the body, and in the cavity of the unloaded body, such as 1 atm"""
    amount: Annotated[float, Quantity("", above=0.0)] = 1.0
    """amount times absolute temperature in the loaded body, relative to the unloaded one"""


class Windkessel(Spec):
    """An elastic chamber at rest that is open to a cavity: both have one pressure, in proportion to what fills it."""

    compliance: Annotated[float, Quantity("m^3/Pa", above=0.0)]
    """volume that flows from the cavity into the chamber for each unit of pressure, such as 1.2 ml/mmHg"""
    volume: Annotated[float, Quantity("m^3", above=0.0)]
    """volume of the cavity at which the pressure is 'pressure'"""
    pressure: Annotated[float, Quantity("Pa")] = 0.0
    """pressure at this volume"""


CONTROLS = ("volume", "unloaded_volume", "gas", "windkessel")
"""Keys of a cavity that determine its unknown pressure."""


class Cavity(Spec):
    """A hollow of the body: the space between a surface of the body and lids on its openings.

    With 'volume', 'unloaded_volume', 'gas' or 'windkessel' the pressure in it is unknown, and acts on its surface.
    """

    surface: TextOrTexts
    """region of the boundary around the cavity; several regions, such as [left, right], of connected cavities: these
    have one pressure, and their volumes are added"""
    lid: Annotated[Literal["planar"] | Lid, Field(union_mode="left_to_right")] = "planar"
    """lids of all openings, which follow their rims: planar, {region: NAME} or {apex: [x, y, z]}. A planar lid joins
    the rim by straight lines to the mean of its vertices, and is flat where the rim is"""

    volume: Annotated[float, Quantity("m^3", above=0.0)] | None = None
    """given volume in the loaded body of a forward analysis, whose pressure is unknown"""
    unloaded_volume: Annotated[float, Quantity("m^3", above=0.0)] | None = None
    """given volume in the undeformed body of an inverse analysis or a round trip, whose pressure is unknown"""
    gas: Gas | None = None
    """gas that fills the cavity, whose pressure is unknown"""
    windkessel: Windkessel | None = None
    """elastic chamber that takes what leaves the cavity, whose pressure is unknown"""

    @property
    def is_controlled(self) -> bool:
        """True if the pressure is unknown."""
        return any(getattr(self, key) is not None for key in CONTROLS)

    @property
    def lid_region(self) -> str | None:
        return None if self.lid == "planar" else self.lid.region

    @property
    def regions(self) -> tuple[str, ...]:
        """Regions of the boundary around the cavity."""
        return self.surface if self.lid_region is None else (*self.surface, self.lid_region)

    @property
    def apex(self) -> tuple[float, float, float] | None:
        """Fixed apex (m) of all lids."""
        return None if self.lid == "planar" else self.lid.apex

    @property
    def pressures(self) -> tuple[Pressure, ...]:
        """The effects of the unknown pressure, which begins with 0."""
        regions = self.regions if self.is_controlled else ()
        return tuple(Pressure(effect="pressure", region=region, pressure=0.0) for region in regions)

    def numbers(self) -> dict[KeyPath, Number | str]:
        """The numbers that determine the unknown pressure, by place."""
        numbers: dict[KeyPath, Number | str] = {}
        for key in CONTROLS:
            control = getattr(self, key)
            if isinstance(control, Spec):
                dimensions = quantities_of(type(control))
                numbers |= {(key, name): Number(getattr(control, name), d) for name, d in dimensions.items()}
            elif control is not None:
                numbers[(key,)] = Number(control, VOLUME)
        return numbers

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if not self.surface:
            yield ("surface",), "has no region"
        keys = [key for key in CONTROLS if getattr(self, key) is not None]
        if len(keys) > 1:
            yield (keys[1],), f"is given in addition to '{keys[0]}': one of them determines the pressure"


def unsuited_controls(job: Any) -> Faults:
    """Faults of cavities of unknown pressure in a job, with their places in the job."""
    controlled = {name: cavity for name, cavity in job.cavities.items() if cavity.is_controlled}
    for i, state in enumerate(job.states):
        yield from ((("states", i, *place), text) for place, text in _unsuited_state(state, job.cavities))
    names = [*controlled, *(name for state in job.states for name in sorted(state.controlled))]
    if not names:
        return
    if controlled and job.states:
        text = "is not valid with 'states': give 'volumes' in each state, and 'unloaded_volumes' in the given one"
        yield ("cavities", names[0]), text
        return
    yield from _known_volumes(controlled, is_inverse=job.analysis != "forward" and job.first != "forward")
    yield from _pressed_twice(job.effects[: job.own_effect_count], controlled.values())


def _known_volumes(cavities: Mapping[str, Cavity], *, is_inverse: bool) -> Faults:
    """Faults of volumes that are given, but that the mesh already has, with their places in the job."""
    key, other = ("unloaded_volume", "volume") if is_inverse else ("volume", "unloaded_volume")
    for name, cavity in cavities.items():
        if getattr(cavity, other) is not None:
            known = "loaded" if is_inverse else "undeformed"
            yield ("cavities", name, other), f"is known: the mesh is the {known} body. Give '{key}'"


def _pressed_twice(effects: Sequence[Effect], cavities: Iterable[Cavity]) -> Faults:
    """Faults of given pressures on the surfaces of cavities of unknown pressure, with their places in the job."""
    regions = {region for cavity in cavities for region in cavity.regions}
    for i, effect in enumerate(effects):
        if isinstance(effect, Pressure) and effect.region in regions:
            text = f"'{effect.region}' belongs to a cavity of unknown pressure: remove the effect, or give no volume"
            yield ("effects", i, "region"), text


def _unsuited_state(state: StateSpec, cavities: Mapping[str, Cavity]) -> Faults:
    """Faults of the cavities of unknown pressure in a state, with their places in it."""
    for key, volumes in (("volumes", state.volumes), ("unloaded_volumes", state.unloaded_volumes)):
        for name in volumes:
            if name not in cavities:
                yield (
                    (key, name),
                    f"is not in 'cavities'.{did_you_mean(name, cavities) if cavities else ''}".rstrip("."),
                )
    yield from _pressed_twice(state.effects, [cavities[name] for name in state.controlled & cavities.keys()])


def cavities_of_state(cavities: Mapping[str, Cavity], state: StateSpec) -> dict[str, Cavity]:
    """Return the cavities of a job in one of its states, with the volumes that are given there."""

    def volumes(name: str) -> dict[str, float | None]:
        return {"volume": state.volumes.get(name), "unloaded_volume": state.unloaded_volumes.get(name)}

    return {name: cavity.model_copy(update=volumes(name)) for name, cavity in cavities.items()}


def unknown_cavities(
    quantities: Sequence[QuantityOfInterest], cavities: Mapping[str, Cavity], states: Sequence[StateSpec]
) -> Faults:
    """Faults of quantities of cavities that the job does not have, or whose pressure is given."""
    controlled = {"": {name for name, cavity in cavities.items() if cavity.is_controlled}}
    controlled |= {state.name: state.controlled for state in states}
    for i, quantity in enumerate(quantities):
        if quantity.cavity is None:
            continue
        if quantity.cavity not in cavities:
            hint = did_you_mean(quantity.cavity, cavities) if cavities else ""
            yield (i, "cavity"), f"there is no cavity '{quantity.cavity}'; define it in 'cavities'.{hint}".rstrip(".")
            continue
        for part in parts(quantity):
            if part.dimension == STRESS and part.cavity not in controlled[part.state or ""]:
                where = f" in state '{part.state}'" if part.state else ""
                text = f"the pressure of cavity '{part.cavity}' is not unknown{where}: give it a volume, gas or"
                yield (i, "of"), f"{text} windkessel, or take the pressure from the effects"
