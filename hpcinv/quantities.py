"""Numbers with units: ``963 kg/m^3`` in a job file becomes an SI float, and a wrong dimension an error.

Plain numbers are SI. Conversion is exact up to one final rounding, so ``8.5 mm`` and ``8.5e-3`` are the same float.
The dimension of a model's field stays readable (`dimension_of`), since the solver scales its unknowns with it.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_args

from pydantic_core import core_schema

from hpcinv.spelling import did_you_mean

if TYPE_CHECKING:
    from pint import UnitRegistry
    from pydantic import BaseModel, GetCoreSchemaHandler, GetJsonSchemaHandler
    from pydantic.json_schema import JsonSchemaValue


class Dimension(NamedTuple):
    """Exponents of length, mass and time."""

    length: int = 0
    mass: int = 0
    time: int = 0

    def __str__(self) -> str:
        if self in _NAMES:
            return _NAMES[self]
        powers = [f"{base}^{n}" if n != 1 else base for base, n in zip(self._fields, self, strict=True) if n]
        return "quantity of dimension " + " ".join(powers)


_NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
_SYMBOL = r"[^\W\d][\w]*|%|°"
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*(.*?)\s*", re.DOTALL)
_FACTOR = re.compile(rf"\s*([*/·]|\s)?\s*({_SYMBOL})(?:(?:\^|\*\*)?([+-]?\d{{1,2}}|[⁻]?[²³¹]))?")
_WORDS = {"%": "percent", "°": "degree"}  # signs that pint takes for operators
_SUPERSCRIPTS = str.maketrans("⁻¹²³", "-123")


@cache
def _units() -> UnitRegistry[Any]:
    import pint  # 0.4 s: only where a unit occurs

    return pint.UnitRegistry(str(Path(__file__).with_name("units.txt")), non_int_type=Fraction)


@cache
def _unit(symbol: str) -> tuple[Fraction, Dimension]:
    """Exact SI factor and dimension of one unit symbol; ``ValueError`` if there is no such unit."""
    registry = _units()
    try:
        factor, base = registry.get_base_units(_WORDS.get(symbol, symbol))
    except AttributeError:  # pint's UndefinedUnitError is one
        known = [prefix + str(name) for prefix in ("", *"nuµmckMG") for name in registry]
        raise ValueError(f"unknown unit '{symbol}'.{did_you_mean(symbol, known, list_all=False)}") from None
    powers = {name.strip("[]"): int(str(n)) for name, n in base.dimensionality.items()}
    return Fraction(str(factor)), Dimension(**powers)


def parse_unit(text: str) -> tuple[Fraction, Dimension]:
    """Exact SI factor and dimension of a unit such as ``kg/m^3`` or ``N mm``; empty text is the pure number one."""
    factor, total = Fraction(1), Dimension()
    text = re.sub(r"^\s*1\s*/", "/", text)
    position, end = 0, len(text.rstrip())
    while position < end:
        match = _FACTOR.match(text, position)
        if match is None or (position == 0 and match[1] in ("*", "·")):
            raise ValueError(f"'{text}' is not a unit; write one like m, kg/m^3 or m/s^2")
        power = int((match[3] or "1").translate(_SUPERSCRIPTS)) * (-1 if match[1] == "/" else 1)
        scale, dimension = _unit(match[2])
        factor *= scale**power
        total = Dimension(*(a + power * b for a, b in zip(total, dimension, strict=True)))
        position = match.end()
    return factor, total


def parse_quantity(text: str) -> tuple[float, Dimension]:
    """SI value and dimension of ``<number> <unit>``; ``ValueError`` tells what is wrong with it."""
    match = _QUANTITY.fullmatch(text)
    if match is None:
        raise ValueError(f"'{text}' is not a number, with or without a unit")
    factor, dimension = parse_unit(match[2])
    return float(Fraction(match[1]) * factor), dimension


@dataclass(frozen=True)
class Quantity:
    """What a field of a job expects, as metadata of an ``Annotated[float, …]``.

    Args:
        name: of the physical quantity, with its article, as error messages say it.
        unit: the SI unit, which a plain number is taken in.
        dimension: exponents that a unit must have; None takes any.
        infinite: a word that stands for infinity, where that has a meaning.
    """

    name: str
    unit: str
    dimension: Dimension | None
    infinite: str = ""

    def parse(self, value: object) -> float:
        """SI value of a number or of text with a unit; ``ValueError`` if it is neither or of another dimension."""
        if self.infinite and value == self.infinite:
            return math.inf
        if isinstance(value, str):
            number, dimension = parse_quantity(value)
            if self.dimension is not None and dimension != self.dimension:
                raise ValueError(f"must be {self._wanted}, but '{value}' is {dimension}")
        elif isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"must be {self._wanted}, not {value!r}")
        else:
            number = float(value)
        if not math.isfinite(number) and not (self.infinite and number == math.inf):
            raise ValueError(f"must be finite, not {value!r}")
        return number

    @property
    def _wanted(self) -> str:
        unit = f" (in {self.unit}, or with a unit)" if self.unit else ""
        return f"{self.name}{unit}" + (f" or '{self.infinite}'" if self.infinite else "")

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        def serialize(value: float) -> float | str:
            return self.infinite if math.isinf(value) else value

        return core_schema.no_info_plain_validator_function(
            self.parse, serialization=core_schema.plain_serializer_function_ser_schema(serialize, when_used="json")
        )

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        text: dict[str, Any] = {"type": "string", "pattern": rf"^\s*{_NUMBER}\s*\S*"}
        choices = [{"type": "number"}, text] + ([{"const": self.infinite}] if self.infinite else [])
        return {"anyOf": choices, "examples": [f"1 {self.unit}"] if self.unit else [1]}


Length = Annotated[float, Quantity("a length", "m", Dimension(1, 0, 0))]
Time = Annotated[float, Quantity("a time", "s", Dimension(0, 0, 1))]
Mass = Annotated[float, Quantity("a mass", "kg", Dimension(0, 1, 0))]
Velocity = Annotated[float, Quantity("a velocity", "m/s", Dimension(1, 0, -1))]
Acceleration = Annotated[float, Quantity("an acceleration", "m/s^2", Dimension(1, 0, -2))]
Frequency = Annotated[float, Quantity("a frequency or angular velocity", "1/s", Dimension(0, 0, -1))]
Area = Annotated[float, Quantity("an area", "m^2", Dimension(2, 0, 0))]
Volume = Annotated[float, Quantity("a volume", "m^3", Dimension(3, 0, 0))]
Density = Annotated[float, Quantity("a density", "kg/m^3", Dimension(-3, 1, 0))]
Force = Annotated[float, Quantity("a force", "N", Dimension(1, 1, -2))]
Stress = Annotated[float, Quantity("a stress", "Pa", Dimension(-1, 1, -2))]
BulkStress = Annotated[float, Quantity("a stress", "Pa", Dimension(-1, 1, -2), infinite="incompressible")]
Dimensionless = Annotated[float, Quantity("a pure number", "", Dimension())]
AnyQuantity = Annotated[float, Quantity("a number or a quantity", "", None)]

QUANTITIES: dict[str, Quantity] = {
    name: get_args(kind)[1]
    for name, kind in dict(globals()).items()
    if get_args(kind)[1:] and isinstance(get_args(kind)[1], Quantity)
}
"""Quantity types by the name under which a mesh generator may annotate its parameters."""

_NAMES = {q.dimension: q.name for q in reversed(QUANTITIES.values()) if q.dimension is not None}


def _quantity_in(annotation: Any, metadata: tuple[Any, ...] | list[Any] = ()) -> Quantity | None:
    for item in metadata:
        if isinstance(item, Quantity):
            return item
    arguments = get_args(annotation)
    inner = getattr(annotation, "__metadata__", ())
    nested = arguments if isinstance(annotation, UnionType) or not inner else arguments[:1]
    found = (_quantity_in(a, inner) for a in nested if a is not None and a is not Ellipsis)
    return next((q for q in (*(m for m in inner if isinstance(m, Quantity)), *found) if q is not None), None)


def quantities_of(model: type[BaseModel]) -> dict[str, Dimension]:
    """Dimension of every field of ``model`` that is a quantity, or a tuple of them."""
    found = {name: _quantity_in(field.annotation, field.metadata) for name, field in model.model_fields.items()}
    return {name: q.dimension for name, q in found.items() if q is not None and q.dimension is not None}


def dimension_of(model: type[BaseModel], field: str) -> Dimension:
    """Dimension of one field, of its entries where it is a tuple; ``KeyError`` if it is no quantity."""
    return quantities_of(model)[field]
