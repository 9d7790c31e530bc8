"""Volumes of a cavity in the states of a job, each with the pressure there: points of a pressure-volume curve."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from hpcinv.job.cavities import Cavity
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.job.states import StateSpec
from hpcinv.job.vocabulary import CUBIC
from hpcinv.physics.effects.effect import Effect
from hpcinv.physics.effects.pressure import Pressure


@dataclass(frozen=True)
class FillingPoint:
    """A computed volume of a cavity.

    Attributes:
        quantity: name of the volume among the quantities of the job.
        pressure: in Pa, in the state of that volume.
        keys: keys in the job of the numbers that make the pressure.
    """

    quantity: str
    pressure: float
    keys: tuple[str, ...] = ()


def pressure_in(effects: Sequence[Effect], cavity: Cavity) -> tuple[float, list[int]]:
    """Return the pressure (Pa) in a cavity, and which of the effects make it.

    Raises:
        ValueError: it is not one number.
    """
    numbers = [
        i for i, effect in enumerate(effects) if isinstance(effect, Pressure) and effect.region in cavity.regions
    ]
    by_region = dict.fromkeys(cavity.surface, 0.0)
    for i in numbers:
        effect = effects[i]
        assert isinstance(effect, Pressure)
        if not isinstance(effect.pressure, float | int):
            raise ValueError("has a pressure that varies in space, so that it is not a point of a curve")
        if effect.region in by_region:
            by_region[effect.region] += effect.pressure
    if len(set(by_region.values())) > 1:
        raise ValueError(f"has different pressures on {' and '.join(by_region)}")
    return next(iter(by_region.values())), numbers


def pressure_keys(state: int, effects: Sequence[int]) -> tuple[str, ...]:
    """Return the keys in the job of the pressures of some effects of a state."""
    return tuple(f"states[{state}].effects[{number}].pressure" for number in effects)


def filling_points(
    cavity_name: str,
    cavities: Mapping[str, Cavity],
    quantities: Sequence[QuantityOfInterest],
    states: Sequence[StateSpec],
) -> Iterator[FillingPoint]:
    """Yield the volumes of a cavity that are computed, one for each pressure, without the given mesh's.

    Raises:
        ValueError: a state has no single pressure in the cavity.
    """
    by_name = {state.name: (i, state) for i, state in enumerate(states)}
    pressures = set[float]()
    for quantity in quantities:
        if quantity.cavity != cavity_name or quantity.dimension != CUBIC or quantity.state not in by_name:
            continue
        i, state = by_name[quantity.state]
        pressure, numbers = 0.0, list[int]()
        if quantity.over != "reference":
            if state.given or cavity_name in state.controlled:
                continue
            try:
                pressure, numbers = pressure_in(state.effects, cavities[cavity_name])
            except ValueError as error:
                raise ValueError(f"state '{state.name}' {error}") from None
        if pressure not in pressures:
            pressures.add(pressure)
            yield FillingPoint(quantity.name, pressure, pressure_keys(i, numbers))
