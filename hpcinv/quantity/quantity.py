"""Numbers with units: ``963 kg/m^3`` in a job file becomes an SI float, and a wrong dimension an error.

Plain numbers are SI. Conversion is exact up to one final rounding, so ``8.5 mm`` and ``8.5e-3`` are the same float.
The dimension of a model's field stays readable (`dimension_of`), since the solver scales its unknowns with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Annotated, Any, get_args

from pydantic_core import core_schema

from hpcinv.quantity.schema import metadata_in
from hpcinv.quantity.units import NUMBER, as_float, parse_quantity, parse_unit
from hpcinv.quantity.units import Dimension as Dimension  # part of this module's interface

if TYPE_CHECKING:
    from pydantic import BaseModel, GetCoreSchemaHandler, GetJsonSchemaHandler
    from pydantic.json_schema import JsonSchemaValue


@dataclass(frozen=True)
class Quantity:
    """What a field of a job expects, as metadata of an ``Annotated[float, …]``.

    Args:
        unit: the SI unit that a plain number is taken in; None takes a quantity of any dimension.
        infinite: a word that stands for infinity, where that has a meaning.
        above, at_least, at_most: bounds of the value, in SI.
        remedy: what else to write where a value is out of bounds.
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
            number = as_float(value)
        if not math.isfinite(number) and not (self.infinite and number == math.inf):
            raise ValueError(f"must be finite, not {value!r}")
        if not self.admits(number):
            raise ValueError(f"must be {self.bounds}, not {value}" + (f"; {self.remedy}" if self.remedy else ""))
        return number

    def admits(self, number: float) -> bool:
        """Whether a value (SI) lies within the bounds."""
        return self.above < number and self.at_least <= number <= self.at_most

    @property
    def bounds(self) -> str:
        """The bounds in words, such as ``at least 0 and at most 0.5``."""
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
        text: dict[str, Any] = {"type": "string", "pattern": rf"^\s*{NUMBER}\s*\S*"}
        choices = [{"type": "number"}, text] + ([{"const": self.infinite}] if self.infinite else [])
        return {"anyOf": choices, "examples": [f"1 {self.unit}"] if self.unit else [1]}


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
Size = Annotated[float, Quantity("m", above=0.0)]  # of the cells that a mesh generator makes: halved in a finer mesh
AnyQuantity = Annotated[float, Quantity(None)]

Divisions = int  # number of cells along an edge, for mesh generators: doubled in a finer mesh

QUANTITIES: dict[str, Quantity] = {
    name: get_args(kind)[1]
    for name, kind in dict(globals()).items()
    if get_args(kind)[1:] and isinstance(get_args(kind)[1], Quantity)
}
"""Quantity types by the name under which a mesh generator may annotate its parameters."""


@cache
def quantities_of(model: type[BaseModel]) -> Mapping[str, Dimension]:
    """Dimension of every field of ``model`` that is a quantity, or a tuple of them."""
    found = {
        name: metadata_in(Quantity, field.annotation, *field.metadata) for name, field in model.model_fields.items()
    }
    return {name: q.dimension for name, q in found.items() if q is not None and q.dimension is not None}


def quantity_of(model: type[BaseModel], field: str) -> Quantity:
    """What a field expects; ``KeyError`` if it is no quantity."""
    info = model.model_fields[field]
    found = metadata_in(Quantity, info.annotation, *info.metadata)
    if found is None:
        raise KeyError(field)
    return found


def dimension_of(model: type[BaseModel], field: str) -> Dimension:
    """Dimension of one field, of its entries where it is a tuple; ``KeyError`` if it is no quantity."""
    return quantities_of(model)[field]
