"""Numbers with units: ``963 kg/m^3`` in a job file becomes an SI float, and a wrong dimension an error.

Plain numbers are SI. Conversion is exact up to one final rounding, so ``8.5 mm`` and ``8.5e-3`` are the same float.
The dimensions of a model's fields (`quantities_of`) define their scaling in the dimensionless problem.
"""

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Annotated, Any, get_args

from pydantic import BaseModel, BeforeValidator, GetCoreSchemaHandler, GetJsonSchemaHandler, WithJsonSchema
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import core_schema

from hpcinv.base.quantity.constants import constant, is_arithmetic
from hpcinv.base.quantity.schema import metadata_in
from hpcinv.base.quantity.units import BASE, NUMBER, Dimension, as_float, parse_unit


@dataclass(frozen=True)
class Quantity:
    """Dimension and bounds of a field of a job, as metadata of an ``Annotated[float, …]``.

    Args:
        unit: SI unit of plain numbers; None accepts quantities of any dimension.
        infinite: word for infinity, if an infinite value is allowed.
        above, at_least, at_most: bounds of the value, in SI.
        remedy: advice for values out of bounds.
    """

    unit: str | None
    infinite: str = ""
    above: float = -math.inf
    at_least: float = -math.inf
    at_most: float = math.inf
    remedy: str = ""

    @cached_property
    def dimension(self) -> Dimension | None:
        return None if self.unit is None else parse_unit(self.unit)[1]

    def parse(self, value: object) -> float:
        """SI value of a number or of text with a unit; ``ValueError`` for a wrong type, dimension or bound."""
        if self.infinite and value == self.infinite:
            return math.inf
        number = self._number_of(value)
        if isinstance(value, str) and is_arithmetic(value):
            value = number  # faults are the result's
        if not math.isfinite(number) and not (self.infinite and number == math.inf):
            raise ValueError(f"must be finite, not {value!r}")
        if 0 < abs(number) < sys.float_info.min:
            raise ValueError(f"must be 0 or at least {sys.float_info.min:.2g} (SI): smaller numbers lose digits")
        if not self.admits(number):
            raise ValueError(f"must be {self.bounds}, not {value}" + (f"; {self.remedy}" if self.remedy else ""))
        return number

    def _number_of(self, value: object) -> float:
        if isinstance(value, str):
            number, dimension = constant(value)
            if self.dimension is not None and dimension not in (None, self.dimension):
                raise ValueError(f"must be {self._wanted}, but '{value}' is {dimension}")
            return number
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"must be {self._wanted}, not {value!r}")
        return as_float(value)

    def admits(self, number: float) -> bool:
        """Return whether a value (SI) is within the bounds."""
        return self.above < number and self.at_least <= number <= self.at_most

    @property
    def bounds(self) -> str:
        """The bounds as text, such as ``at least 0 and at most 0.5``."""
        limits = (("above", self.above), ("at least", self.at_least), ("at most", self.at_most))
        return " and ".join(f"{relation} {limit:g}" for relation, limit in limits if math.isfinite(limit))

    @property
    def _wanted(self) -> str:
        name = "a number or a quantity" if self.dimension is None else str(self.dimension)
        unit = f" (in {self.unit}, or with a unit)" if self.unit else ""
        return name + unit + (f" or '{self.infinite}'" if self.infinite else "")

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        def serialize(value: float) -> float | str:
            return self.infinite if math.isinf(value) else value

        return core_schema.no_info_plain_validator_function(
            self.parse, serialization=core_schema.plain_serializer_function_ser_schema(serialize, when_used="json")
        )

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        text: dict[str, Any] = {"type": "string", "pattern": rf"^[\s(+-]*{NUMBER}\s*\S*"}
        choices = [{"type": "number"}, text] + ([{"const": self.infinite}] if self.infinite else [])
        return {"anyOf": choices, "examples": [f"1 {self.unit}"] if self.unit else [1]}


@dataclass(frozen=True)
class Measured:
    """Value in SI and its dimension."""

    value: float
    dimension: Dimension

    def plain(self) -> float | str:
        """The value as it can be written in a job file."""
        powers = [f"{unit}^{n}" for unit, n in zip(BASE, self.dimension, strict=False) if n]
        return " ".join([repr(self.value), *powers]) if powers else self.value


@dataclass(frozen=True)
class MeasuredQuantity(Quantity):
    """Metadata of a field that takes a quantity of any dimension; a plain number is dimensionless."""

    unit: str | None = None

    def measure(self, value: object) -> Measured:
        """Value and dimension; ``ValueError`` if ``value`` is neither a number nor text with a unit."""
        if isinstance(value, Measured):
            return value
        dimension = constant(value)[1] if isinstance(value, str) else None
        return Measured(self.parse(value), dimension or Dimension())

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        plain = core_schema.plain_serializer_function_ser_schema(Measured.plain, when_used="json")
        return core_schema.no_info_plain_validator_function(self.measure, serialization=plain)


Length = Annotated[float, Quantity("m")]
Area = Annotated[float, Quantity("m^2")]
Volume = Annotated[float, Quantity("m^3")]
Time = Annotated[float, Quantity("s")]
Frequency = Annotated[float, Quantity("1/s")]
Velocity = Annotated[float, Quantity("m/s")]
Acceleration = Annotated[float, Quantity("m/s^2")]
Mass = Annotated[float, Quantity("kg")]
Density = Annotated[float, Quantity("kg/m^3", at_least=0.0)]
Force = Annotated[float, Quantity("N")]
Stress = Annotated[float, Quantity("Pa")]
BulkStress = Annotated[float, Quantity("Pa", infinite="incompressible")]
Dimensionless = Annotated[float, Quantity("")]
Size = Annotated[float, Quantity("m", above=0.0)]  # cell size in a mesh generator; halved for a finer mesh
AnyQuantity = Annotated[float, Quantity(None)]

Divisions = int  # number of cells along an edge in a mesh generator; doubled for a finer mesh

QUANTITIES: dict[str, Quantity] = {
    name: get_args(kind)[1]
    for name, kind in dict(globals()).items()
    if get_args(kind)[1:] and isinstance(get_args(kind)[1], Quantity)
}
"""Quantity types by their names in annotations of mesh generators."""

LengthUnit = Annotated[
    Size,
    BeforeValidator(lambda v: f"1 {v}" if isinstance(v, str) and v[:1].isalpha() else v),
    WithJsonSchema({"anyOf": [{"type": "number", "exclusiveMinimum": 0}, {"type": "string"}], "examples": ["mm"]}),
]
"""A unit such as mm; not for mesh generators."""

AnyMeasured = Annotated[Measured, MeasuredQuantity()]  # not for mesh generators


@cache
def quantities_of(model: type[BaseModel]) -> Mapping[str, Dimension]:
    """Dimensions of the fields of ``model`` that are quantities, or tuples of quantities."""
    marks = {
        name: metadata_in(Quantity, field.annotation, *field.metadata) for name, field in model.model_fields.items()
    }
    return {name: q.dimension for name, q in marks.items() if q is not None and q.dimension is not None}


def quantity_of(model: type[BaseModel], field: str) -> Quantity:
    """Metadata of a field; ``KeyError`` if it is not a quantity."""
    info = model.model_fields[field]
    mark = metadata_in(Quantity, info.annotation, *info.metadata)
    if mark is None:
        raise KeyError(field)
    return mark


def positive(value: object, dimension: Dimension | None, owner: str) -> float:
    """Positive value (SI) of the dimension of ``owner``, if that is known; plain numbers are SI.

    Raises:
        ValueError: the value is not positive, or of another dimension.
    """
    number = Quantity(None, above=0.0).parse(value)
    if (
        isinstance(value, str)
        and dimension is not None
        and (dimension_found := constant(value)[1]) not in (None, dimension)
    ):
        raise ValueError(f"must be {dimension}, as {owner} is, but '{value}' is {dimension_found}")
    return number
