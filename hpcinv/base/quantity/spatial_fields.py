"""Quantities that may vary over the body: one number, a number for each region, a formula, or mesh data.

Formulas can use the reference position ``X, Y, Z`` and the current position ``x, y, z``, in both analyses.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, SerializationInfo, ValidationInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import core_schema

from hpcinv.base.quantity.expressions import Expression, definitions_in, writes_definitions
from hpcinv.base.quantity.quantity import Quantity
from hpcinv.base.quantity.schema import shown
from hpcinv.base.quantity.units import Dimension, as_float, parse_unit

ELSEWHERE = "elsewhere"
POSITIONS: dict[str, Dimension | None] = dict.fromkeys("XYZxyz", Dimension(length=1))


@dataclass(frozen=True)
class Field:
    """A quantity that varies over the body; its numbers (SI) by region, or by the names of constants in a formula."""

    numbers: Mapping[str, float] = field(default_factory=dict, kw_only=True, hash=False)
    is_regional: ClassVar = False

    @property
    def is_current(self) -> bool:
        """True if it depends on the current position."""
        return False

    def plain(self, with_definitions: bool = False) -> Any:
        """Return the field as a job file has it, with the definitions of names in a formula if these are asked for."""
        return dict(self.numbers)


@dataclass(frozen=True)
class ByRegion(Field):
    """A value (SI) for each region of cells; ``elsewhere`` for all other cells."""

    numbers: Mapping[str, float]
    is_regional: ClassVar = True

    def value_in(self, region: str) -> float | None:
        """The value in a region, or ``None``."""
        return self.numbers.get(region, self.numbers.get(ELSEWHERE))


@dataclass(frozen=True)
class ByFormula(Field):
    """A formula of position and of named constants, in SI."""

    formula: Expression

    @property
    def is_current(self) -> bool:
        return not self.formula.names.isdisjoint("xyz")

    def plain(self, with_definitions: bool = False) -> str:
        return self.formula.whole if with_definitions else str(self.formula)

    def values_at(self, positions: Mapping[str, Any]) -> Any:
        """Return its values where the coordinates X, Y, Z, x, y, z (m) are these arrays."""
        arguments = {**positions, **self.numbers}
        return self.formula.evaluate(**{name: arguments[name] for name in self.formula.names})


@dataclass(frozen=True)
class ByData(Field):
    """A data array of the mesh file, in units of ``factor`` (SI)."""

    array: str
    unit: str = ""
    components: int = 1

    @property
    def factor(self) -> float:
        return as_float(parse_unit(self.unit)[0])

    def plain(self, with_definitions: bool = False) -> dict[str, str]:
        return {"data": self.array} | ({"unit": self.unit} if self.unit else {})


@dataclass(frozen=True)
class ByRule(Field):
    """Unit vectors that follow from the shape of the body by a rule, a part of the job."""

    rule: Any

    def plain(self, with_definitions: bool = False) -> dict[str, Any]:
        plain: dict[str, Any] = self.rule.model_dump(mode="json")
        return plain


@dataclass(frozen=True)
class VaryingQuantity(Quantity):
    """Metadata of a field of a law or an effect that may vary over the body."""

    def read(self, value: object, definitions: Mapping[str, Expression] = MappingProxyType({})) -> float | Field:
        """Number in SI, or description of a field; ``ValueError`` with the reason if it is invalid.

        Args:
            definitions: formulas of the names in a formula.
        """
        if isinstance(value, Field):
            return value
        if isinstance(value, Mapping):
            return self._data(value) if "data" in value else self._regional(value)
        try:
            return self.parse(value)
        except ValueError:
            if not isinstance(value, str):
                raise
            if not _LIKE_A_FORMULA.search(value) and definitions.keys().isdisjoint(_WORD.findall(value)):
                raise
            formula = Expression.using(value, definitions)
            if not formula.names and not formula.definitions:
                raise
        formula.expect(POSITIONS, self.dimension)
        if not formula.names:
            return self.parse(float(formula.evaluate()))
        return ByFormula(formula)

    def _regional(self, given: Mapping[Any, object]) -> ByRegion:
        if not given:
            raise ValueError("must name regions, such as {core: 1, elsewhere: 2}")
        values = {}
        for region, value in given.items():
            try:
                values[str(region)] = number = self.parse(value)
                if math.isinf(number):
                    raise ValueError(f"cannot be '{self.infinite}'; give that region a separate law")
            except ValueError as error:
                raise ValueError(f"in region '{region}': {error}") from None
        return ByRegion(values)

    def _data(self, given: Mapping[Any, object]) -> ByData:
        array, unit = given["data"], given.get("unit", "")
        if given.keys() - {"data", "unit"} or not isinstance(array, str) or not isinstance(unit, str):
            raise ValueError(f"must name an array of the mesh file, as {{data: NAME, unit: kPa}}, not {shown(given)}")
        dimension = parse_unit(unit)[1]
        if unit and dimension != self.dimension:
            raise ValueError(f"must be {self._wanted}, but '{unit}' is a unit of {dimension}")
        return ByData(array, unit)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        def plain(value: Any, info: SerializationInfo) -> Any:
            if isinstance(value, tuple):
                return [plain(entry, info) for entry in value]
            if isinstance(value, Field):
                return value.plain(writes_definitions(info))
            return self.infinite if value == float("inf") else value

        def read(value: object, info: ValidationInfo) -> Any:
            return self.read(value, definitions_in(info))

        return core_schema.with_info_plain_validator_function(
            read,
            serialization=core_schema.plain_serializer_function_ser_schema(plain, info_arg=True, when_used="json"),
        )

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        single = super().__get_pydantic_json_schema__(schema, handler)
        data = {
            "type": "object",
            "properties": {"data": {"type": "string"}, "unit": {"type": "string"}},
            "required": ["data"],
            "additionalProperties": False,
        }
        return {
            "anyOf": [*single["anyOf"], {"type": "string"}, data, {"type": "object", "additionalProperties": single}]
        }


_WORD = re.compile(r"[A-Za-z]\w*")
_LIKE_A_FORMULA = re.compile(r"[*()+]|\b[XYZxyz]\b")

StressField = Annotated[Any, VaryingQuantity("Pa")]
ModulusField = Annotated[Any, VaryingQuantity("Pa", above=0)]
LameField = Annotated[Any, VaryingQuantity("Pa", infinite="incompressible")]
BulkModulusField = Annotated[Any, VaryingQuantity("Pa", infinite="incompressible", above=0)]
_UPWARD = "for a body that is lighter than the surrounding fluid, give the difference and reverse the acceleration"
DensityField = Annotated[Any, VaryingQuantity("kg/m^3", at_least=0, remedy=_UPWARD)]
NumberField = Annotated[Any, VaryingQuantity("")]
PositiveField = Annotated[Any, VaryingQuantity("", above=0)]
DispersionField = Annotated[Any, VaryingQuantity("", at_least=0, at_most=1 / 3)]
StiffnessField = Annotated[Any, VaryingQuantity("N/m^3", at_least=0)]
MomentField = Annotated[Any, VaryingQuantity("N")]  # per length
ExpansionField = Annotated[Any, VaryingQuantity("1/K")]
ThicknessField = Annotated[Any, VaryingQuantity("m", above=0)]
TemperatureField = Annotated[Any, VaryingQuantity("K")]


def is_uniform(value: object) -> bool:
    """Return whether a quantity, or each entry of a tuple of quantities, is constant over the body."""
    return not fields_in(value)


def fields_in(value: object) -> list[Field]:
    """Return the fields in a quantity, a vector or a tensor."""
    if isinstance(value, tuple):
        return [field for part in value if not isinstance(part, float) for field in fields_in(part)]
    return [value] if isinstance(value, Field) else []


def in_each_region(value: Any) -> Iterator[tuple[str, Any]]:
    """Yield a tuple of quantities as numbers in each region that they name; nothing if they vary otherwise.

    If they are uniform, the name of the region is empty. Regions in which one of them has no value are left out.
    """
    fields = fields_in(value)
    if not fields:
        yield "", value
        return
    regional = [field for field in fields if isinstance(field, ByRegion)]
    if len(regional) == len(fields):
        for region in dict.fromkeys(name for field in regional for name in field.numbers) or [""]:
            if all(field.value_in(region) is not None for field in regional):
                yield region, _value_in(region, value)


def _value_in(region: str, value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(_value_in(region, part) for part in value)
    return value.value_in(region) if isinstance(value, ByRegion) else value


def entries(value: object) -> Iterator[Any]:
    """Yield the numbers and fields of a quantity, a vector or a tensor."""
    if isinstance(value, tuple):
        for part in value:
            yield from entries(part)
    else:
        yield value
