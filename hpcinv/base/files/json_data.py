"""Conversion of data to what JSON can hold."""

import math
from collections.abc import Mapping
from typing import Any

_PLAIN = frozenset((str, int, bool, type(None)))


def json_data(value: Any) -> Any:
    """Return a value with dicts, lists and Python's numbers only, and ``None`` for numbers that are not finite."""
    if type(value) in _PLAIN:  # most values; the tests below take ten times as long
        return value
    if isinstance(value, Mapping):
        return {str(key): json_data(entry) for key, entry in value.items()}
    if hasattr(value, "tolist"):  # of NumPy, which need not be imported here
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [json_data(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
