"""Quantities of any dimension that keep it, for formulas that are checked with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from pydantic_core import core_schema

from hpcinv.quantity.quantity import Quantity
from hpcinv.quantity.units import BASE, Dimension, parse_quantity

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler


@dataclass(frozen=True)
class Measured:
    """A value in SI and its dimension."""

    value: float
    dimension: Dimension

    def plain(self) -> float | str:
        """As a job file may say it."""
        powers = [f"{unit}^{n}" for unit, n in zip(BASE, self.dimension, strict=False) if n]
        return " ".join([repr(self.value), *powers]) if powers else self.value


@dataclass(frozen=True)
class MeasuredQuantity(Quantity):
    """What a field expects that takes a quantity of any dimension; a plain number is a pure one."""

    unit: str | None = None

    def measure(self, value: object) -> Measured:
        """``ValueError`` if it is neither a number nor text with a unit."""
        if isinstance(value, Measured):
            return value
        dimension = parse_quantity(value)[1] if isinstance(value, str) else Dimension()
        return Measured(self.parse(value), dimension)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        plain = core_schema.plain_serializer_function_ser_schema(Measured.plain, when_used="json")
        return core_schema.no_info_plain_validator_function(self.measure, serialization=plain)


AnyMeasured = Annotated[Measured, MeasuredQuantity()]
