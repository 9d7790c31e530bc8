"""Numbers in which two parts of a job differ, and a part in which they are unreadable.

A function that can be evaluated where they are unreadable does not depend on them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from math import isfinite, nan
from typing import Any, NoReturn, cast

from hpcinv.base.quantity.schema import KeyPath, Spec

type Leaves = tuple[KeyPath, ...]
"""places of numbers in a part of a job"""


class LeafRead(BaseException):
    """A number was read that must not be; not an ``Exception``, so that no function can handle it."""


def _refuse(self: Any, *_: Any) -> NoReturn:
    raise LeafRead


class UnreadableNumber(float):
    """Stands for a finite number: what is done with it raises `LeafRead`, except for questions about its type.

    Functions of C, as in `math`, find the float that it was made of.
    """

    __slots__ = ()

    for _name in (
        *("__bool__", "__float__", "__int__", "__hash__", "__eq__", "__ne__", "__lt__", "__le__", "__gt__", "__ge__"),
        *("__neg__", "__pos__", "__abs__", "__round__", "__trunc__", "__ceil__", "__floor__"),
        *("__add__", "__radd__", "__sub__", "__rsub__", "__mul__", "__rmul__", "__truediv__", "__rtruediv__"),
        *("__pow__", "__rpow__", "__floordiv__", "__rfloordiv__", "__mod__", "__rmod__", "__divmod__", "__rdivmod__"),
        *("__repr__", "__str__", "__format__", "__reduce__", "__reduce_ex__", "__getnewargs__", "__copy__"),
        *("__deepcopy__", "hex", "is_integer", "as_integer_ratio", "conjugate"),
    ):
        locals()[_name] = _refuse
    del _name


UNREADABLE = tuple(map(UnreadableNumber, (nan, 0.0, 1e-300, 1e300, -1e300)))
"""as functions of C find them: in none of these may a value differ"""


_PLAIN = (str, int, bool, set)


def changed_leaves(before: Any, after: Any) -> Leaves | None:
    """Return the places of the finite floats in which two parts differ; ``None`` if they differ in more than these.

    Parts that are the same object are equal.
    """
    leaves: list[KeyPath] = []
    return tuple(leaves) if _collect(before, after, (), leaves) else None


def _collect(before: Any, after: Any, place: KeyPath, leaves: list[KeyPath]) -> bool:
    """Add the places of floats that differ; return whether there is no other difference."""
    if before is after:
        return True
    kind = type(before)
    if kind is not type(after):
        return False
    if kind is float:
        leaves.append(place)
        return isfinite(before) and isfinite(after)
    if kind in _PLAIN:
        return bool(before == after)
    entries = _ENTRIES.get(kind) or (_fields if isinstance(before, Spec) else None)
    return entries is not None and _collect_entries(entries(before), entries(after), place, leaves)


def _collect_entries(
    before: Collection[tuple[Any, Any]], after: Collection[tuple[Any, Any]], place: KeyPath, leaves: list[KeyPath]
) -> bool:
    if len(before) != len(after):
        return False
    for (name, one), (other_name, other) in zip(before, after, strict=True):
        if name != other_name or not (one is other or _collect(one, other, (*place, name), leaves)):
            return False
    return True


def _fields(part: Spec) -> list[tuple[str, Any]]:
    """Return the values of a section of a job by name, and which of them are given."""
    own, private = part.__dict__, part.__pydantic_private__ or {}
    return [*own.items(), *private.items(), ("given", part.__pydantic_fields_set__)]


_ENTRIES: Mapping[type, Callable[[Any], Collection[tuple[Any, Any]]]] = {
    tuple: lambda part: [*enumerate(part)],
    list: lambda part: [*enumerate(part)],
    dict: dict.items,
}
"""entries of a collection with their places"""


def unreadable_variants(part: Any, leaves: Leaves) -> Iterator[Any]:
    """Yield a part of a job with each kind of unreadable numbers at some places."""
    for number in UNREADABLE:
        yield _with(number, part, leaves)


def _with(number: UnreadableNumber, part: Any, leaves: Leaves) -> Any:
    if leaves == ((),):
        return number
    below: dict[str | int, list[KeyPath]] = {}
    for first, *rest in leaves:
        below.setdefault(first, []).append(tuple(rest))

    def changed(name: str | int, entry: Any) -> Any:
        return _with(number, entry, tuple(below[name])) if name in below else entry

    if isinstance(part, tuple | list):
        return type(part)(changed(i, entry) for i, entry in enumerate(part))
    if isinstance(part, Mapping):
        return {name: changed(name, entry) for name, entry in part.items()}
    copied = cast(Spec, part).model_copy()
    for values in (copied.__dict__, copied.__pydantic_private__ or {}):
        values.update({name: changed(name, entry) for name, entry in values.items()})
    return copied
