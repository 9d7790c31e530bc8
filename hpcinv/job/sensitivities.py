"""The section ``sensitivities`` of a job: keys of numbers of laws, effects, …, and their standard deviations."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.keys import JobKey, parse_key
from hpcinv.base.quantity.quantity import AnyQuantity, positive
from hpcinv.base.quantity.schema import KeyPath, ListOf, Spec, collected, dotted_key, raise_if_any, shown
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.units import Dimension
from hpcinv.job.cavities import Cavity
from hpcinv.job.shell_section import Shell
from hpcinv.job.states import StateSpec
from hpcinv.job.support import Support

type Owner = Ingredient | Support | Shell | Cavity | StateSpec

TIES = ("also", "scale")
"""fields with the keys of numbers that change with another one"""


class Uncertain(Spec):
    """Uncertainty of a number by which the results are differentiated, and numbers that change with it."""

    sd: AnyQuantity | None = None
    """its standard deviation"""
    also: ListOf[JobKey] = ()
    """keys of further numbers that have the same value and change with it, such as the density in other states"""
    scale: ListOf[JobKey] = ()
    """keys of further numbers that are multiplied by the same factor, such as the other stiffnesses of a law"""


@dataclass(frozen=True)
class Parameter:
    """A number of a job by which the results are differentiated.

    Attributes:
        where: key of its owner in the job.
        owner: law, effect, family of fibres, support, shell, cavity or state; ``None`` for the mesh.
        value: in SI.
        dimension: ``None`` if it depends on the use in a formula.
        deviation: its standard deviation in SI, or ``None``.
        ties: further numbers that change with it.
        kind: of a tie: ``also`` or ``scale``.
        ratio: of a tie: its value relative to the parameter's.
    """

    key: str
    where: str
    owner: Owner | None
    place: KeyPath
    value: float
    dimension: Dimension | None
    deviation: float | None = None
    ties: tuple["Parameter", ...] = ()
    kind: str = ""
    ratio: float = 1.0

    @property
    def tied_keys(self) -> dict[str, list[str]]:
        """Keys of the ties by their kind, as the sections of a job have them."""
        keys = {kind: [tie.key for tie in self.ties if tie.kind == kind] for kind in TIES}
        return {kind: names for kind, names in keys.items() if names}


def read_sensitivities(given: object, owners: Mapping[str, Owner]) -> dict[str, Uncertain]:
    """Standard deviations (SI) and ties by key.

    Args:
        owners: laws, effects, the families of fibres that they use, supports, cavities, states, and the shell, by their
            keys in the job.

    Raises:
        Problems: the section has faults.
    """
    if not isinstance(given, Mapping | list | tuple):
        raise ValueError(f"must be a list of keys, or a mapping of keys to standard deviations, not {shown(given)}")
    entries: list[tuple[int | str, object, object]]
    if isinstance(given, Mapping):
        entries = [(str(key), key, value) for key, value in given.items()]
    else:
        entries = [(i, key, None) for i, key in enumerate(given)]
    uncertain: dict[str, Uncertain] = {}
    problems: list[tuple[KeyPath, str]] = []
    for place, key, value in entries:
        known = {name for first, entry in uncertain.items() for name in (first, *entry.also)}
        with collected(problems, place):
            number = _number(key, owners, known)
            entry: Mapping[object, object] = value if isinstance(value, Mapping) else {"sd": value}
            uncertain[number.key] = _uncertain(number, entry, owners, known)
    raise_if_any(problems)
    return uncertain


def _uncertain(
    number: Parameter, entry: Mapping[object, object], owners: Mapping[str, Owner], known: set[str]
) -> Uncertain:
    """Return deviation and ties of a number.

    Args:
        known: keys of the numbers of earlier entries.
    """
    if unknown := entry.keys() - Uncertain.model_fields.keys():
        raise ValueError(f"has {shown(min(map(str, unknown)))}; it may have sd, also and scale")
    known.add(number.key)
    keys: dict[str, tuple[str, ...]] = {}
    for kind in TIES:
        others = entry.get(kind, ())
        if not isinstance(others, list | tuple):
            raise ValueError(f"{kind} must be a list of keys, not {shown(others)}")
        for other in others:
            tied = _number(other, owners, known)
            known.add(tied.key)
            if fault := fault_of_tie(tied, number, kind):
                raise ValueError(fault)
        keys[kind] = tuple(others)
    deviation = entry.get("sd")
    sd = None if deviation is None else positive(deviation, number.dimension, number.key)
    return Uncertain.model_construct(sd=sd, also=keys["also"], scale=keys["scale"])


def _number(key: object, owners: Mapping[str, Owner], known: set[str]) -> Parameter:
    """The parameter of a key that is not yet known; ``ValueError`` if there is none."""
    if not isinstance(key, str):
        raise ValueError(f"must be a key such as material.mu, not {shown(key)}")
    if key in known:
        raise ValueError(f"{key} is duplicated")
    return parameter(key, owners, None)


def fault_of_tie(tied: Parameter, number: Parameter, kind: str) -> str | None:
    """Fault of a number that shall have the value of another one (``also``), or keep its ratio to it (``scale``)."""
    if kind == "scale":
        return f"{number.key} is 0, so that {tied.key} has no ratio to it" if number.value == 0.0 else None
    if tied.dimension != number.dimension:
        return f"{tied.key} is {tied.dimension}, but {number.key} is {number.dimension}"
    return None


def fault_of_setting(number: Parameter) -> str | None:
    """Fault of a number that is to be set in the job, but follows there from others."""
    unset_number = getattr(number.owner, "unset_number", None)  # not of all owners
    reason = unset_number(number.place) if unset_number else ""
    return f"{number.key} {reason}" if reason else None


def uncertain_parameters(given: Mapping[str, Uncertain], owners: Mapping[str, Owner]) -> list[Parameter]:
    """The parameters of a section, with what changes with each."""
    parameters = []
    for key, entry in given.items():
        number = parameter(key, owners, entry.sd)
        equal = [replace(parameter(other, owners, None), kind="also") for other in entry.also]
        scaled = [replace(parameter(other, owners, None), kind="scale") for other in entry.scale]
        scaled = [replace(tie, ratio=tie.value / number.value) for tie in scaled]
        parameters.append(replace(number, ties=(*equal, *scaled)))
    return parameters


def tied_parameters(parameters: Sequence[Parameter]) -> list[Parameter]:
    """The parameters and all that changes with them."""
    return [number for parameter in parameters for number in (parameter, *parameter.ties)]


def stated_values(parameters: Sequence[Parameter], values: Iterable[float]) -> dict[str, float | str]:
    """Return values (SI) exactly, as a job may state them, by key, with what changes with each parameter."""
    return {
        tied.key: f"{tied.ratio * float(value)!r} {unit}" if unit else tied.ratio * float(value)
        for number, value in zip(parameters, values, strict=True)
        for tied in (number, *number.ties)
        for unit in [tied.dimension.unit if tied.dimension is not None else ""]
    }


def parameter(key: str, owners: Mapping[str, Owner], deviation: float | None) -> Parameter:
    """The parameter of a key; ``ValueError`` if the key is not a number of one of the owners."""
    location, known = tuple(parse_key(key)), dict[KeyPath, str]()
    for where, owner in owners.items():
        begin = _location(where)
        for place, number in owner.numbers().items():
            if (*begin, *place) == location:
                if isinstance(number, str):
                    raise ValueError(f"{key} {number}: there is no derivative by it")
                return Parameter(key, where, owner, place, number.value, number.dimension, deviation)
            if not isinstance(number, str):
                known[(*begin, *place)] = dotted_key((*begin, *place))
    if inner_keys := [name for place, name in known.items() if place[: len(location)] == location]:
        raise ValueError(f"{key} is not one number; choose {' or '.join(_first(inner_keys))}")
    hint = (
        did_you_mean(key, known.values(), list_all=False) or f" Possible keys are {', '.join(_first(known.values()))}."
    )
    raise ValueError(
        f"{key} is not a number of a law, an effect, fibres, a support, a shell or a cavity in this job.{hint}"
    )


def _location(where: str) -> KeyPath:
    """``effects[0]``, ``states[1].effects[0]``, ``material.REGION`` and ``fibres.NAME`` as places in a job."""
    state, _, rest = where.rpartition("].")
    state_place = _location(f"{state}]") if state else ()
    section, bracket, number = rest.partition("[")
    return (*state_place, section, int(number.removesuffix("]"))) if bracket else (*state_place, *rest.split(".", 1))


def _first(names: Iterable[str]) -> list[str]:
    """The first four, and an ellipsis if there are more."""
    listed = list(names)
    return listed[:4] + (["…"] if len(listed) > 4 else [])
