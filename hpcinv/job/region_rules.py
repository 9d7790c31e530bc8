"""Rules that define regions of a job: a condition on places and normals, other regions, a smooth face, or vertices."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, SerializationInfo, ValidationInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import core_schema

from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.quantity import Quantity
from hpcinv.base.quantity.schema import shown

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


ANGLE = math.radians(30)
"""rad between the normals of neighbouring facets of a smooth face; if it is raised, faces pass over sharper edges"""
_POINT, _ANGLE = Quantity("m"), Quantity("", above=0.0, at_most=math.pi)


@dataclass(frozen=True)
class SmoothFace:
    """The boundary facet nearest to a point, with all facets that are reached from it over edges that are not sharp.

    Attributes:
        point: m.
        angle: rad between the normals of two neighbouring facets above which their edge is sharp.
    """

    point: tuple[float, float, float]
    angle: float = ANGLE

    @property
    def plain(self) -> dict[str, object]:
        """The mapping as a job writes it, in SI units."""
        return {"smooth": list(self.point), "angle": self.angle}

    def __str__(self) -> str:
        place = ", ".join(f"{x:g}" for x in self.point)
        return f"smooth face at ({place}) m within {math.degrees(self.angle):g} deg"


@dataclass(frozen=True)
class VertexSet:
    """The vertices of the mesh at some points, which only supports can hold.

    Attributes:
        points: m.
    """

    points: tuple[tuple[float, float, float], ...]

    @property
    def plain(self) -> dict[str, object]:
        """The mapping as a job writes it, in SI units."""
        return {"vertices": [list(point) for point in self.points]}

    def __str__(self) -> str:
        return f"{len(self.points)} vertices"


def _union(names: Sequence[object]) -> RegionUnion:
    texts = [name for name in names if isinstance(name, str)]
    if not names or len(texts) < len(names):
        raise ValueError(f"must be a condition, or names of regions such as [endo, epi], not {shown(names)}")
    members = tuple(name for name in texts if not name.startswith(EXCEPT))
    without = tuple(name.removeprefix(EXCEPT).strip() for name in texts if name.startswith(EXCEPT))
    if not members:
        raise ValueError(f"must name a region from which to leave out others, such as [boundary, {texts[0]}]")
    return RegionUnion(members, without)


def _vertex_set(value: Mapping[object, object]) -> VertexSet:
    """Raise ``ValueError`` unless the mapping is a list of points."""
    points = value["vertices"]
    if (
        value.keys() - {"vertices"}
        or not isinstance(points, list | tuple)
        or not points
        or not all(map(_is_point, points))
    ):
        raise ValueError(f"must be such as {{vertices: [[0, 0, 0], [10 mm, 0, 0]]}}, not {shown(value)}")
    return VertexSet(tuple(_coordinates(point) for point in points))


def _is_point(value: object) -> bool:
    return isinstance(value, list | tuple) and len(value) == 3


def _coordinates(value: Sequence[object]) -> tuple[float, float, float]:
    x, y, z = (_POINT.parse(component) for component in value)
    return x, y, z


def _smooth_face(value: Mapping[object, object]) -> SmoothFace:
    """Raise ``ValueError`` unless the mapping is a point and perhaps an angle."""
    point, angle = value.get("smooth"), value.get("angle", ANGLE)
    if not _is_point(point) or value.keys() - {"smooth", "angle"}:
        raise ValueError(f"must be such as {{smooth: [0, 0, 2 mm], angle: 30 deg}}, not {shown(value)}")
    assert isinstance(point, list | tuple)  # for mypy
    return SmoothFace(_coordinates(point), _ANGLE.parse(angle))


class _Rule:
    """Annotation of a condition, a list of names, a smooth face, or vertices."""

    @staticmethod
    def _read(value: object, info: ValidationInfo) -> Expression | RegionUnion | SmoothFace | VertexSet:
        if isinstance(value, RegionUnion | SmoothFace | VertexSet):
            return value
        if isinstance(value, Mapping) and "vertices" in value:
            return _vertex_set(value)
        if isinstance(value, Mapping) and "smooth" in value:
            return _smooth_face(value)
        if not isinstance(value, list | tuple):
            return Expression.read(value, info)
        return _union(value)

    @staticmethod
    def _plain(
        rule: Expression | RegionUnion | SmoothFace | VertexSet, info: SerializationInfo
    ) -> str | list[str] | dict[str, object]:
        if isinstance(rule, SmoothFace | VertexSet):
            return rule.plain
        return rule.entries if isinstance(rule, RegionUnion) else rule.plain(info)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        plain = core_schema.plain_serializer_function_ser_schema(self._plain, info_arg=True)
        return core_schema.with_info_plain_validator_function(self._read, serialization=plain)

    def __get_pydantic_json_schema__(self, schema: core_schema.CoreSchema, handler: Any) -> JsonSchemaValue:
        names = {"type": "array", "items": {"type": "string"}, "minItems": 1}
        number = {"type": ["string", "number"]}
        point = {"type": "array", "items": number, "minItems": 3, "maxItems": 3}
        face = {
            "type": "object",
            "properties": {"smooth": point, "angle": number},
            "required": ["smooth"],
            "additionalProperties": False,
        }
        vertices = {
            "type": "object",
            "properties": {"vertices": {"type": "array", "items": point, "minItems": 1}},
            "required": ["vertices"],
            "additionalProperties": False,
        }
        return {"anyOf": [number, names, face, vertices]}


RegionRule = Annotated[Expression | RegionUnion | SmoothFace | VertexSet, _Rule()]
