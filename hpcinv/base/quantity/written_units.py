"""Values in the units in which a job is written, as the terminal, pages and pictures show them."""

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from hpcinv.base.quantity.units import parse_unit, prefixed_unit

SHOWN = ("m", "Pa")
"""SI units of the quantities whose unit a job chooses; others have a prefix by their size"""
_ROUNDING = 1e-12
"""share of a vector's largest component below which a component is shown as 0"""
_QUANTITY = re.compile(r"(?<![\w.])\d+(?:\.\d*)?(?:[eE][-+]?\d+)?\s*([A-Za-zµμ]{1,4})(?![\w/^*(-])")
_STRESS = re.compile(r"[nuµμmkMG]?Pa")


def written_units(data: Any) -> dict[str, str]:
    """Return the symbol of the unit that a job has most often for lengths and stresses, by SI unit.

    The first of two that are as frequent counts. A kind of quantity that has no unit in the job is left out.

    Args:
        data: the job as it is written, of mappings, lists, texts and numbers.
    """
    counts = {unit: Counter[str]() for unit in SHOWN}
    for symbol in _symbols(data):
        try:
            dimension = parse_unit(symbol)[1].unit
        except ValueError:  # a word after a number
            continue
        if dimension in counts and (dimension != "Pa" or _STRESS.fullmatch(symbol)):
            counts[dimension][symbol] += 1
    return {unit: symbols.most_common(1)[0][0] for unit, symbols in counts.items() if symbols}


def _symbols(data: Any) -> Iterator[str]:
    if isinstance(data, Mapping):
        for key, value in data.items():
            yield from [value] if key == "unit" and isinstance(value, str) else _symbols(value)
    elif isinstance(data, list | tuple):
        for value in data:
            yield from _symbols(value)
    elif isinstance(data, str):
        yield from _QUANTITY.findall(data)


def unit_of(values: Sequence[float | None], unit: str, symbols: Mapping[str, str]) -> tuple[float, str]:
    """Return size and symbol of the unit in which values in an SI unit are shown: the job's, or one with a prefix."""
    if unit in symbols:
        return float(parse_unit(symbols[unit])[0]), symbols[unit]
    largest = max((abs(value) for value in values if value is not None and math.isfinite(value)), default=0.0)
    return prefixed_unit(largest, unit)


def as_shown(
    value: float | Sequence[float | None] | None, unit: str, symbols: Mapping[str, str], digits: int = 6
) -> str:
    """Return a number or a vector in an SI unit as text, with the unit in which it is shown."""
    values = value if isinstance(value, Sequence) else [value]
    size, symbol = unit_of(values, unit, symbols)
    least = _ROUNDING * max((abs(number) for number in values if number is not None), default=0.0)
    kept = [0.0 if number is not None and abs(number) < least else number for number in values]
    numbers = ["not finite" if number is None else f"{number / size:.{digits}g}" for number in kept]
    text = f"({', '.join(numbers)})" if isinstance(value, Sequence) else numbers[0]
    return f"{text} {symbol}" if symbol and (isinstance(value, Sequence) or value is not None) else text
