"""The section ``states`` of a job: loads and supports of one body in each of its states."""

from collections.abc import Iterator, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from typing import Annotated

from pydantic import Field, ValidationInfo

from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.parameter_paths import Number
from hpcinv.base.quantity.quantity import Quantity
from hpcinv.base.quantity.schema import Faults, KeyPath, ListOf, Name, Spec, repeated
from hpcinv.base.quantity.spatial_fields import fields_in
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.units import Dimension
from hpcinv.job.support import Support
from hpcinv.physics.effects import AnyEffect

VOLUME = Dimension(length=3)
REST = "rest"
"""Name of the rest shape where no state is it."""


class StateSpec(Spec):
    """A state of the body. Without effects and supports it is the rest shape, which is free of stress."""

    name: Name
    """its name in results"""
    given: bool = False
    """whether the mesh is the body in this state; true for exactly one state"""
    effects: ListOf[AnyEffect] = ()
    """loads and inelastic strains of this state"""
    supports: ListOf[Support] | None = Field(default=None, exclude_if=lambda supports: supports is None)
    """supports of this state; by default the job's"""
    volumes: Mapping[Name, Annotated[float, Quantity("m^3", above=0.0)]] = Field(default={}, exclude_if=lambda v: not v)
    """volumes of cavities in this state by name, whose pressures are unknown"""
    unloaded_volumes: Mapping[Name, Annotated[float, Quantity("m^3", above=0.0)]] = Field(
        default={}, exclude_if=lambda v: not v
    )
    """of the given state: volumes of cavities in the rest shape by name, whose pressures in this state are unknown"""
    start: Name | None = Field(default=None, exclude_if=lambda start: start is None)
    """state at which its load path begins; by default the rest shape"""

    @property
    def is_rest(self) -> bool:
        """True for the body without loads and supports."""
        return not self.effects and self.supports is None and not self.controlled

    def numbers(self) -> dict[KeyPath, Number | str]:
        """The given volumes of cavities, by place."""
        given = {"volumes": self.volumes, "unloaded_volumes": self.unloaded_volumes}
        return {
            (key, name): Number(volume, VOLUME) for key, volumes in given.items() for name, volume in volumes.items()
        }

    @property
    def controlled(self) -> set[str]:
        """Names of the cavities of unknown pressure."""
        return {*self.volumes, *self.unloaded_volumes}

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if self.start is not None and self.is_rest:
            yield ("start",), "is not valid for the rest shape, a state without effects and supports"
        elif self.start is not None and self.given:
            yield ("start",), "is not valid for the given state: the rest shape is solved from it"
        if self.given and self.volumes:
            yield ("volumes",), "are known: the mesh is the body in this state. Give 'unloaded_volumes'"
        elif self.unloaded_volumes and not self.given:
            yield ("unloaded_volumes",), "are valid for the given state only. Give 'volumes'"


def faults_of_states(states: Sequence[StateSpec]) -> Faults:
    """Faults of the list of states, with their places in it."""
    names = [state.name for state in states]
    for i in repeated(names):
        yield (i, "name"), f"'{names[i]}' is the name of an earlier state"
    given = [i for i, state in enumerate(states) if state.given]
    if not given:
        yield (), "none of them is given: write 'given: true' at the state in which the mesh is"
    for i in given[1:]:
        yield (i, "given"), f"the mesh is already '{names[given[0]]}': only one state can be given"
    yield from _faults_of_rest([i for i, state in enumerate(states) if state.is_rest], names)
    yield from _faults_of_starts(states, names)


def _faults_of_rest(rest: Sequence[int], names: Sequence[str]) -> Faults:
    """Faults of the states without loads.

    Args:
        rest: their places among all states.
    """
    for i in rest[1:]:
        yield (i,), f"has neither effects nor supports, so it is the rest shape, as '{names[rest[0]]}' already is"
    if REST in names and not rest:
        yield (names.index(REST), "name"), f"'{REST}' is the shape without effects and supports: choose another name"
    if len(rest) == len(names):
        yield (), "none of them is loaded: give one of them effects or supports"


def _faults_of_starts(states: Sequence[StateSpec], names: Sequence[str]) -> Faults:
    for i, state in enumerate(states):
        if state.start is not None and state.start not in names:
            yield (i, "start"), f"there is no state '{state.start}'.{did_you_mean(state.start, names)}"
    try:
        TopologicalSorter({state.name: [state.start] if state.start else [] for state in states}).prepare()
    except CycleError as error:
        cycle = error.args[1][::-1]
        yield (names.index(cycle[0]), "start"), f"leads back to the state itself: {' -> '.join(cycle)}"


def solve_order(states: Sequence[StateSpec]) -> list[int]:
    """Indices of the loaded states in the order in which they are solved: the given one, then each after its start."""
    loaded = [i for i, state in enumerate(states) if not state.is_rest]
    number = {states[i].name: i for i in loaded}
    order = [i for i in loaded if states[i].given]
    while len(order) < len(loaded):
        order += [
            i for i in loaded if i not in order and ((s := states[i].start) not in number or number[str(s)] in order)
        ]
    return order


def rest_of(states: Sequence[StateSpec]) -> str:
    """Name of the rest shape."""
    return next((state.name for state in states if state.is_rest), REST)


def given_on_current(ingredient: Ingredient) -> Iterator[KeyPath]:
    """Yield places of what an ingredient attaches to the material, but gives on the current body."""
    for field in ("given_on", "density_in"):
        if getattr(ingredient, field, None) == "current":
            yield (field,)
    for name, (value, _) in ingredient.quantities().items():
        if ingredient.is_attached(name) and any(field.is_current for field in fields_in(value)):
            yield (name,)
