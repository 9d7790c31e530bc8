"""Walk through every leaf of a section of jobs: values that mean something else there, one leaf at a time.

Values are not validated, so that no leaf is left out because other leaves forbid it. Where a section is absent, the
walk goes through a sample of each kind that it may be.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeAliasType, Union, get_args, get_origin, get_type_hints

from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.quantity import Measured
from hpcinv.base.quantity.schema import OneOf, Spec, members_of
from hpcinv.base.quantity.spatial_fields import ByData, ByFormula, ByRegion, VaryingQuantity
from hpcinv.base.quantity.units import Dimension
from hpcinv.job.region_rules import RegionUnion, SmoothFace, VertexSet

type Place = tuple[str, ...]

FORMULAS = [Expression("q*x", (("q", "1"),)), Expression("q*x", (("q", "2"),)), Expression("2*x")]
"""the same text with other definitions of its name, and other texts"""
FIELDS = [
    1.25,
    2.5,
    *map(ByFormula, FORMULAS[:3]),
    ByRegion({"core": 1.0, "elsewhere": 2.0}),
    ByRegion({"core": 1.0, "elsewhere": 3.0}),
    ByData("wall"),
    ByData("wall", "mm"),
]
"""a quantity in every way in which it can be said"""
RULES = [RegionUnion(("a", "b"), ("c",)), SmoothFace((0.0, 1.0, 2.0)), VertexSet(((0.0, 1.0, 2.0),)), *FORMULAS]
_SCALARS: dict[Any, list[Any]] = {
    bool: [True, False],
    int: [3, 4],
    float: [1.25, 2.5],
    str: ["a", "b"],
    Expression: FORMULAS,
    Measured: [Measured(1.0, Dimension()), Measured(2.0, Dimension()), Measured(1.0, Dimension(length=1))],
}


def variations(annotation: Any, value: Any) -> Iterator[tuple[Place, list[Any]]]:
    """Yield the place of each leaf, and values of the whole that differ in it only; the first may be the given one."""
    kind = _unwrapped(annotation)[0]
    if not isinstance(value, tuple) and any(_varies(member) for member in _members(annotation)):
        yield (), FIELDS
    elif isinstance(value, Spec):
        for name, field in type(value).model_fields.items():
            whole = Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
            for place, values in variations(whole, getattr(value, name)):
                yield (name, *place), [value.model_copy(update={name: one}) for one in values]
    elif isinstance(value, Expression) or kind is Expression:
        yield (), FORMULAS
    elif dataclasses.is_dataclass(value) and not isinstance(value, Measured):
        hints = get_type_hints(type(value))
        for part in dataclasses.fields(value):
            for place, values in variations(hints[part.name], getattr(value, part.name)):
                yield (part.name, *place), [dataclasses.replace(value, **{part.name: one}) for one in values]  # type: ignore[type-var]
    elif isinstance(value, Mapping) and value:
        yield from _of_mapping(kind, value)
    elif isinstance(value, tuple) and value:
        yield from _of_tuple(kind, value)
    elif value is None or isinstance(value, Mapping | tuple):
        found = list(samples(annotation))
        yield (), [value, *found]
        for sample in found:
            yield from variations(annotation, sample)
    else:
        yield (), list(dict.fromkeys([value, *samples(annotation)]))


def _of_mapping(kind: Any, value: Mapping[Any, Any]) -> Iterator[tuple[Place, list[Any]]]:
    entry = next((get_args(one)[1] for one in _members(kind) if get_origin(one) is Mapping), Any)
    first = next(iter(value))
    more = {**value, "further": value[first]}
    yield (), [value, {"other": value[first]}, more, dict(reversed(more.items()))]
    for name, one in value.items():
        for place, values in variations(entry, one):
            yield (name, *place), [{**value, name: changed} for changed in values]


def _of_tuple(kind: Any, value: tuple[Any, ...]) -> Iterator[tuple[Place, list[Any]]]:
    found = [get_args(one) for one in _members(kind) if get_origin(one) is tuple]
    entries = found[0] if found else (Any, ...)
    if entries[-1] is ...:
        yield (), [value, (*value, value[0])]
    for i, one in enumerate(value):
        for place, values in variations(entries[0] if entries[-1] is ... else entries[i], one):
            yield (str(i), *place), [(*value[:i], changed, *value[i + 1 :]) for changed in values]


def samples(annotation: Any) -> Iterator[Any]:
    """Yield values of every kind that an annotation admits, other than nothing."""
    kind, marks = _unwrapped(annotation)
    families = [mark for mark in marks if isinstance(mark, OneOf)]
    if _varies(annotation):
        yield from FIELDS
    elif families:
        for member in members_of(families[0].family or kind, families[0].tag).values():
            yield _sample(member)
    elif set(_members(kind)) >= {RegionUnion, SmoothFace}:
        yield from RULES
    else:
        for member in _members(kind):
            yield from samples(member) if get_origin(member) is Annotated else _samples_of_member(member)


def _samples_of_member(kind: Any) -> Iterator[Any]:
    origin, arguments = get_origin(kind), get_args(kind)
    if kind in (NoneType, Any):
        return
    if origin is Literal:
        yield from arguments
    elif origin is Mapping:
        yield from ({"name": one} for one in samples(arguments[1]))
    elif origin is tuple and arguments[-1] is ...:
        yield from ((one,) for one in samples(arguments[0]))
    elif origin is tuple:
        first = [next(samples(one)) for one in arguments]
        yield tuple(first)
    elif isinstance(kind, type) and issubclass(kind, Spec):
        yield _sample(kind)
    else:
        yield from _SCALARS[kind]


def _sample(kind: type[Spec]) -> Spec:
    """Return a part of a job: its example, or one with the least that it needs."""
    if (example := getattr(kind, "example", None)) is not None:
        return kind.model_validate(example)
    needed = {
        name: next(samples(Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation))
        for name, field in kind.model_fields.items()
        if field.is_required()
    }
    return kind.model_construct(**needed)


def _unwrapped(annotation: Any) -> tuple[Any, list[Any]]:
    """Return an annotation without its marks, and the marks."""
    marks: list[Any] = []
    while get_origin(annotation) is Annotated or isinstance(annotation, TypeAliasType):
        if isinstance(annotation, TypeAliasType):
            annotation = annotation.__value__
            continue
        annotation, *more = get_args(annotation)
        marks += more
    return annotation, marks


def _varies(annotation: Any) -> bool:
    return any(isinstance(mark, VaryingQuantity) for mark in _unwrapped(annotation)[1])


def _members(annotation: Any) -> list[Any]:
    """Return the members of a union, without their marks."""
    kind, marks = _unwrapped(annotation)
    if get_origin(kind) in (Union, UnionType):
        return [one for member in get_args(kind) for one in _members(member)]
    return [annotation if any(isinstance(mark, OneOf | VaryingQuantity) for mark in marks) else kind]
