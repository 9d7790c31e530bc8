"""Dotted keys, such as ``effects[0].density`` in a job and ``solutions[].factorizations`` in a summary."""

import re
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any

from pydantic import AfterValidator

from hpcinv.base.quantity.schema import shown

_NAME = r"[A-Za-z_][\w-]*"
_KEY = re.compile(rf"{_NAME}(?:\.{_NAME}|\[\d*\])*")

type KeyPart = str | int | None


@cache
def parse_key(text: str) -> tuple[KeyPart, ...]:
    """Parts of a key: names, numbers in brackets, and ``None`` for ``[]`` (all entries of a list).

    Raises:
        ValueError: the text is not a key.
    """
    if _KEY.fullmatch(text) is None:
        raise ValueError(f"{shown(text)} is not a key; write one such as mesh.parameters.size or effects[0].density")
    parts = re.findall(rf"({_NAME})|\[(\d*)\]", text)
    return tuple(name or (int(number) if number else None) for name, number in parts)


def _is_key(text: str) -> str:
    parse_key(text)
    return text


def _is_key_of_a_job(text: str) -> str:
    if None in parse_key(text):
        raise ValueError(f"{shown(text)} is not one place in a job: put a number between the brackets")
    return text


SummaryKey = Annotated[str, AfterValidator(_is_key)]
JobKey = Annotated[str, AfterValidator(_is_key_of_a_job)]


def assigned(data: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Copy of a job's data with values at the keys of ``settings``; missing sections are added.

    Unchanged parts are shared with ``data``, which is not modified.

    Raises:
        ValueError: a key leads through a value that is not a section, or beyond the end of a list.
    """
    changed: Any = dict(data)
    for key, value in settings.items():
        try:
            changed = _assigned_below(changed, parse_key(key), value)
        except ValueError as error:
            raise ValueError(f"cannot set {key}: {error}") from None
    result: dict[str, Any] = changed
    return result


def _assigned_below(place: Any, parts: tuple[KeyPart, ...], value: Any) -> Any:
    """Copy of a section or list with another value at a key below it."""
    if not parts:
        return value
    part, rest = parts[0], parts[1:]
    if isinstance(part, int):
        if place == {}:
            raise ValueError(f"there is no list with an entry [{part}] yet; write the whole list first")
        if not isinstance(place, list) or part >= len(place):
            count = f"a list of {len(place)}" if isinstance(place, list) else "a value that is not a list"
            raise ValueError(f"[{part}] is not an entry of {count}")
        return [*place[:part], _assigned_below(place[part], rest, value), *place[part + 1 :]]
    if not isinstance(place, dict):
        raise ValueError(f"'{part}' cannot be set in {shown(place)}, which is not a section")
    return {**place, part: _assigned_below(place.get(part, {}), rest, value)}


def look_up(summary: Any, key: str) -> float | None:
    """Number at a key, with ``[]`` the sum over the entries that have one; ``None`` if there is no number."""
    return _number(summary, parse_key(key))


def _number(place: Any, parts: tuple[KeyPart, ...]) -> float | None:
    if not parts:
        return float(place) if isinstance(place, int | float) else None
    part, rest = parts[0], parts[1:]
    if part is None:
        return _sum_of(place, rest)
    is_item = isinstance(part, int) and isinstance(place, list) and part < len(place)
    is_entry = isinstance(part, str) and isinstance(place, Mapping) and part in place
    return _number(place[part], rest) if is_item or is_entry else None


def _sum_of(entries: Any, parts: tuple[KeyPart, ...]) -> float | None:
    found = [_number(entry, parts) for entry in entries] if isinstance(entries, list) else []
    numbers = [number for number in found if number is not None]
    return sum(numbers) if numbers else None
