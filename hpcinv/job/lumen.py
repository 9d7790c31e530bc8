"""Walls around the lumen of a vessel, as they stand in the section 'mesh' of a job."""

from typing import Annotated, Any

from pydantic import BeforeValidator, GetJsonSchemaHandler, ValidationInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import core_schema

from hpcinv.base.quantity.quantity import Length, Size
from hpcinv.base.quantity.schema import Faults, ListOf, Spec, Triple

WALL, INNER, OUTER = "wall", "inner", "outer"
"""regions of a vessel: its cells, its surface at the lumen, and its outer surface"""
OPEN = "open"


class Wall(Spec):
    """Thickness of the wall of a vessel by the distance from its first end, along the lumen."""

    distance: ListOf[Length] = (0.0,)
    """increasing distances; the thickness is linear between them and constant beyond the last"""
    thickness: ListOf[Size]
    """thickness at each distance"""

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """JSON schema of a table, or of one thickness."""
        return {
            "anyOf": [{"type": "number"}, {"type": "string"}, super().__get_pydantic_json_schema__(schema, handler)]
        }

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if not self.thickness or len(self.distance) != len(self.thickness):
            given = f"has {len(self.thickness)} entries, and 'distance' {len(self.distance)}"
            yield ("thickness",), f"{given}: there must be one at each distance"
        if any(b <= a for a, b in zip(self.distance, self.distance[1:], strict=False)):
            yield ("distance",), "must increase"


class End(Spec):
    """A flat, open end of a vessel."""

    at: Triple[Length]
    """a point near the middle of an end of the lumen, or where the lumen is cut"""
    normal: Triple[float] | None = None
    """direction out of the vessel, of any length: the lumen is cut there by a plane; without it, it ends there"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if self.normal is not None and not any(self.normal):
            yield ("normal",), "must not be zero"


def _table(given: object) -> object:
    """Return one thickness as a table."""
    return {"thickness": [given]} if isinstance(given, str | int | float) else given


def _named(given: object) -> object:
    if isinstance(given, str) and given != OPEN:
        raise ValueError(f"must be '{OPEN}', or a mapping of names to places, not '{given[:40]}'")
    return {} if given == OPEN else given


def also_open(schema: dict[str, Any]) -> None:
    """Let the JSON schema of named ends accept the word for all of them."""
    named = {key: schema.pop(key) for key in ("type", "additionalProperties", "propertyNames") if key in schema}
    schema["anyOf"] = [{"const": OPEN}, named]


WallThickness = Annotated[Wall, BeforeValidator(_table)]
OR_OPEN = BeforeValidator(_named)
