"""A material law whose parameters are fitted: which of its numbers are free, within which bounds."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import ValidationError

from hpcinv.base.quantity.arrays import Floats
from hpcinv.base.quantity.keys import assigned, parse_key
from hpcinv.base.quantity.parameter_paths import Number
from hpcinv.base.quantity.quantity import quantity_of
from hpcinv.base.quantity.schema import KeyPath, dotted_key, job_error, problems_in
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.units import Dimension, parse_unit
from hpcinv.errors import JobError
from hpcinv.physics.materials import MaterialLaw, laws

STRESS = parse_unit("Pa")[1]
_TERMS = re.compile(r"([\w-]+):(\d+)")
_MOST_TERMS = 8
LARGEST_EXPONENT = 20.0
"""Bound of the magnitude of pure numbers for which the law has none."""
_MODULI = {("young",), ("poisson",)}  # found among the numbers of a law, but they follow from its parameters


@dataclass(frozen=True)
class FreeParameter:
    """A number of a law that is fitted.

    Attributes:
        place: in the law, such as ``("mu", 0)``.
        lower, upper: bounds (SI) that the law sets.
    """

    place: KeyPath
    dimension: Dimension
    lower: float = -math.inf
    upper: float = math.inf

    @property
    def key(self) -> str:
        return f"material.{dotted_key(self.place)}"

    @property
    def name(self) -> str:
        return dotted_key(self.place)

    @property
    def is_stress(self) -> bool:
        return self.dimension == STRESS


@dataclass(frozen=True)
class Candidate:
    """A law with starting values of its parameters.

    Attributes:
        label: what the user asked for, such as ``ogden:2``.
        data: the law's section of a job, with starting values.
    """

    label: str
    law: MaterialLaw
    data: Mapping[str, Any]
    parameters: tuple[FreeParameter, ...]

    @property
    def places(self) -> list[KeyPath]:
        return [parameter.place for parameter in self.parameters]

    @property
    def start(self) -> Floats:
        return _values(self.law, self.places)

    def published(self) -> Iterator[Floats]:
        """Yield values of the law's starting values for jobs, where they have the same parameters."""
        for values in type(self.law).starting_values.values():
            data = {**self.data, **values.parameters}
            try:
                law = type(self.law).model_validate(data)
                yield _values(law, self.places)
            except (ValidationError, KeyError):  # another number of terms
                continue

    def section(self, values: Sequence[float]) -> dict[str, Any]:
        """Return the section ``material`` of a job with values (SI) of the parameters."""
        data: dict[str, Any] = dict(self.data)
        texts = {p.name: quantity(v, p.dimension) for p, v in zip(self.parameters, values, strict=True)}
        return assigned(data, texts)


def quantity(value: float, dimension: Dimension) -> float | str:
    """Return a value with 10 digits in the form of a job: stresses in kPa or MPa, others in SI."""
    return short(value, dimension, 10) if dimension.unit else float(f"{value:.10g}")


def short(value: float, dimension: Dimension, digits: int = 5) -> str:
    """Return a value (SI) with its unit."""
    if dimension == STRESS and value:
        scale, unit = next(((s, u) for s, u in ((1e6, "MPa"), (1e3, "kPa")) if abs(value) >= s / 10), (1.0, "Pa"))
        return f"{value / scale:.{digits}g} {unit}"
    return f"{value:.{digits}g} {dimension.unit}".strip()


def _fixed_of(law: type[MaterialLaw], data: Mapping[str, Any], fixed: Mapping[str, str]) -> dict[str, str]:
    """Return the fixed values that a law has."""
    return {
        key: value for key, value in fixed.items() if key.partition("[")[0] in law.model_fields or key in _known(data)
    }


def candidate(text: str, fixed: Mapping[str, str], *, compressible: bool) -> Candidate:
    """Return the law that a user names, ``NAME``, ``NAME:TERMS`` or a mapping as in a job.

    Args:
        fixed: values of parameters that are not fitted, by name; those that the law does not have are left out.
        compressible: whether the bulk modulus is fitted, too; otherwise it is infinite, unless it is given.

    Raises:
        JobError: there is no such law, it has fibres, or it does not take these values.
    """
    place = Path(f"--law {text}")
    given, terms = _given(text)
    name, is_whole = str(given.get("law")), len(given) > 1
    law = _isotropic_law(name, place)
    data = _repeat_terms(given if is_whole else law.example, law, terms, place)
    fixed = _fixed_of(law, data, fixed)
    bulk = law.replaceable[1] if law.replaceable else ""
    is_stated = bulk in fixed or (is_whole and bulk in given)
    if bulk and not (compressible or is_stated) and (not is_whole or law.model_fields[bulk].is_required()):
        data = {**data, bulk: "incompressible"}
    model, section = _model(law, data, fixed, "" if is_stated else bulk, place)
    kept = {parse_key(_key(key, section)) for key in fixed}
    if bulk and not compressible:
        kept.add((bulk,))
    parameters = tuple(_parameters(model, kept))
    if not parameters:
        raise JobError(f"{place}: all of its parameters are fixed")
    return Candidate(name if is_whole else text, model, section, parameters)


def _isotropic_law(name: str, place: Path) -> type[MaterialLaw]:
    law = laws().get(name)
    if law is None:
        raise JobError(f"{place}: unknown law '{name}'.{did_you_mean(name, laws())}")
    if law.model_validate(law.example).families:
        isotropic = [n for n, kind in laws().items() if not kind.model_validate(kind.example).families]
        raise JobError(
            f"{place}: has fibres, whose direction these tests do not state; take one of {', '.join(isotropic)}"
        )
    return law


def _model(
    law: type[MaterialLaw], data: Mapping[str, Any], fixed: Mapping[str, str], bulk: str, place: Path
) -> tuple[MaterialLaw, Mapping[str, Any]]:
    """Return the law with fixed values, and its section of a job.

    Args:
        bulk: name of the bulk modulus, if nothing states its value.
    """
    try:
        data = assigned(data, {_key(key, data): yaml.safe_load(value) for key, value in fixed.items()})
        return law.model_validate(data), data
    except ValidationError as error:
        remedy = []
        if bulk and any(where[:1] == (bulk,) for where, _ in problems_in(error)):
            remedy = [f"{place}: give --compressible to fit {bulk}, or its value with --fix {bulk}=…"]
        raise JobError(*job_error(place, error, law).problems, *remedy) from None
    except ValueError as error:
        raise JobError(f"{place}: --fix: {error}") from None


def _given(text: str) -> tuple[dict[str, Any], int | None]:
    """Return the section that a text states, and a number of terms."""
    if match := _TERMS.fullmatch(text):
        return {"law": match[1]}, int(match[2])
    if not text.lstrip().startswith("{"):
        return {"law": text}, None
    try:
        section = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise JobError(f"--law {text}: is not a mapping: {' '.join(str(error).split())}") from None
    return section, None


def _repeat_terms(data: Mapping[str, Any], law: type[MaterialLaw], terms: int | None, place: Path) -> dict[str, Any]:
    """Return the data with lists of some length, by repetition of their last entries."""
    lists = [name for name, value in law.example.items() if isinstance(value, list)]
    if terms is None:
        return dict(data)
    if not lists:
        raise JobError(f"{place}: this law has no number of terms; write {law.example['law']}")
    if not 1 <= terms <= _MOST_TERMS:
        raise JobError(f"{place}: the number of terms must be from 1 to {_MOST_TERMS}")
    return {name: [*value, *value[-1:] * terms][:terms] if name in lists else value for name, value in data.items()}


def _known(data: Mapping[str, Any]) -> Mapping[str, Any]:
    parameters = data.get("parameters", {})
    return parameters if isinstance(parameters, Mapping) else {}


def _key(name: str, data: Mapping[str, Any]) -> str:
    return f"parameters.{name}" if name in _known(data) else name


def _parameters(law: MaterialLaw, kept: set[tuple[Any, ...]]) -> Iterator[FreeParameter]:
    for place, number in law.numbers().items():
        if place in _MODULI or not isinstance(number, Number) or any(place[: len(k)] == k for k in kept):
            continue
        assert number.dimension is not None
        if place[0] == "parameters":
            yield FreeParameter(place, number.dimension)
            continue
        bounds = quantity_of(type(law), str(place[0]))
        if not bounds.bounds and number.dimension == Dimension():
            yield FreeParameter(place, number.dimension, -LARGEST_EXPONENT, LARGEST_EXPONENT)
            continue
        # An excluded bound is kept away from by less than matters.
        lowest = bounds.above + 1e-9 * max(abs(bounds.above), 1e-3) if math.isfinite(bounds.above) else -math.inf
        yield FreeParameter(place, number.dimension, max(lowest, bounds.at_least), bounds.at_most)


def _values(law: MaterialLaw, places: Sequence[KeyPath]) -> Floats:
    numbers = law.numbers()
    entries = [numbers[place] for place in places]
    if not all(isinstance(number, Number) for number in entries):
        raise KeyError
    return np.array([number.value for number in entries if isinstance(number, Number)])
