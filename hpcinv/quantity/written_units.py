"""Units in which a job writes lengths and stresses, for what is shown of its results."""

import re
from collections import Counter

from hpcinv.quantity.units import parse_unit

_QUANTITY = re.compile(
    r"(?<![\w.])[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?\s*([A-Za-zµμ]{1,4})(?![\w/^*(-])|\bunit:\s*([A-Za-zµμ]{1,4})\b"
)
_COMMENT = re.compile(r"(^|\s)#.*")
_SHOWN = ("m", "Pa")
_STRESSES = re.compile(r"^[nuµμmkMG]?Pa$")


def written_units(text: str) -> dict[str, tuple[float, str]]:
    """Return the size and the symbol of the unit that the text of a job has most often, for lengths and stresses.

    The first of two that are as frequent counts. A kind of quantity without a unit in the text is left out.
    """
    counts = {unit: Counter[str]() for unit in _SHOWN}
    for line in text.splitlines():
        for match in _QUANTITY.finditer(_COMMENT.sub("", line)):
            symbol = match[1] or match[2]
            try:
                dimension = parse_unit(symbol)[1].unit
            except ValueError:
                continue
            if dimension in counts and (dimension != "Pa" or _STRESSES.match(symbol)):
                counts[dimension][symbol] += 1
    chosen = {unit: symbols.most_common(1)[0][0] for unit, symbols in counts.items() if symbols}
    return {unit: (float(parse_unit(symbol)[0]), symbol) for unit, symbol in chosen.items()}
