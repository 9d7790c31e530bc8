"""Other names in formulas of energies, where laws of several materials meet in one job."""

import re
from collections.abc import Mapping

_WORD = re.compile(r"[^\W\d]\w*")


def renamed(formula: str, names: Mapping[str, str], families: Mapping[str, str]) -> str:
    """Return a formula with other names.

    Args:
        names: new names of parameters and definitions.
        families: new names of families of fibres, which invariants such as ``I4_f`` end with.
    """

    def new_name(match: re.Match[str]) -> str:
        invariant, _, family = match[0].partition("_")
        return f"{invariant}_{families[family]}" if family in families else names.get(match[0], match[0])

    return _WORD.sub(new_name, formula)
