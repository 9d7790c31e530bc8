"""How a job defines a region: by a condition on places and normals, or by the union of other regions without some."""

from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, SerializationInfo, ValidationInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import core_schema

from hpcinv.quantity.expressions import Expression
from hpcinv.quantity.schema import shown

EXCEPT = "not "
"""begins an entry of a list whose region is left out"""


@dataclass(frozen=True)
class RegionUnion:
    """A region that has all facets and cells of some regions, but none of further ones.

    Attributes:
        members: names of regions.
        without: names of regions whose facets and cells are left out.
    """

    members: tuple[str, ...]
    without: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """All regions that it names."""
        return self.members + self.without

    @property
    def entries(self) -> list[str]:
        """The list as a job writes it."""
        return [*self.members, *(EXCEPT + name for name in self.without)]

    def __str__(self) -> str:
        return f"[{', '.join(self.entries)}]"


class _Rule:
    """Annotation of a condition or a list of names."""

    @staticmethod
    def _read(value: object, info: ValidationInfo) -> Expression | RegionUnion:
        if isinstance(value, RegionUnion):
            return value
        if not isinstance(value, list | tuple):
            return Expression.read(value, info)
        if not value or not all(isinstance(name, str) for name in value):
            raise ValueError(f"must be a condition, or names of regions such as [endo, epi], not {shown(value)}")
        members = tuple(name for name in value if not name.startswith(EXCEPT))
        without = tuple(name.removeprefix(EXCEPT).strip() for name in value if name.startswith(EXCEPT))
        if not members:
            raise ValueError(f"must name a region from which to leave out others, such as [boundary, {value[0]}]")
        return RegionUnion(members, without)

    @staticmethod
    def _plain(rule: Expression | RegionUnion, info: SerializationInfo) -> str | list[str]:
        return rule.entries if isinstance(rule, RegionUnion) else rule.plain(info)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        plain = core_schema.plain_serializer_function_ser_schema(self._plain, info_arg=True)
        return core_schema.with_info_plain_validator_function(self._read, serialization=plain)

    def __get_pydantic_json_schema__(self, schema: core_schema.CoreSchema, handler: Any) -> JsonSchemaValue:
        names = {"type": "array", "items": {"type": "string"}, "minItems": 1}
        return {"anyOf": [{"type": ["string", "number"]}, names]}


RegionRule = Annotated[Expression | RegionUnion, _Rule()]
