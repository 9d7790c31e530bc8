"""Elements of FEBio's files that have a type and parameters."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from hpcinv.base.quantity.arrays import Floats
from hpcinv.formats.cards.card import CardError


@dataclass(frozen=True)
class Entry:
    """A material or another element: its type, its parameters, and the entries within it.

    Attributes:
        tag: name of its element in the file.
        values: text of its parameters by name, and formulas (``type="math"``).
        factors: values of the load curves of parameters at the end, by name.
        maps: parameters that are given by an array of the file, with the name of that array.
    """

    tag: str
    type: str
    values: Mapping[str, str]
    factors: Mapping[str, float]
    maps: Mapping[str, str]
    parts: tuple[Entry, ...] = ()

    def number(self, name: str, default: float | None = None) -> float:
        """Return a parameter times its load curve."""
        if name not in self.values and name not in self.maps and default is not None:
            return default
        try:
            value = float(self.values[name]) * self.factors.get(name, 1.0)
        except (KeyError, ValueError):
            value = math.nan
        if not math.isfinite(value):
            text = self.maps.get(name) or self.values.get(name)
            raise CardError(f"{self.type or self.tag}: {name} is not a number: {text}")
        return value

    def vector(self, name: str) -> Floats:
        """Return a parameter of three numbers times its load curve."""
        return vector(self.values.get(name), f"{self.type or self.tag}: {name}") * self.factors.get(name, 1.0)

    def part(self, tag: str) -> Entry | None:
        """Return the first entry of a tag within this one."""
        return next((part for part in self.parts if part.tag == tag), None)


def vector(text: str | None, place: str) -> Floats:
    """Return the three finite numbers in a text."""
    try:
        numbers = np.array((text or "").replace(",", " ").split(), dtype=np.float64)
    except ValueError:
        numbers = np.zeros(0)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise CardError(f"{place} is not three numbers: {text}")
    return numbers


def entry_of(item: ET.Element, curve: Callable[[str], float]) -> Entry:
    """Return an element of a file.

    Args:
        curve: value of a load curve by its number.
    """
    values: dict[str, str] = {}
    factors: dict[str, float] = {}
    maps: dict[str, str] = {}
    parts: list[Entry] = []
    for child in item:
        kind = child.get("type")
        if kind == "map":
            maps[child.tag] = (child.text or "").strip()
        elif len(child) or (kind is not None and kind != "math"):
            parts.append(entry_of(child, curve))
        else:
            values[child.tag] = (child.text or "").strip()
        if number := child.get("lc"):
            factors[child.tag] = curve(number)
    text = (item.text or "").strip()
    if text and not len(item):
        values[""] = text
    return Entry(item.tag, item.get("type", ""), values, factors, maps, tuple(parts))
