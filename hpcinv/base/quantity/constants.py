"""Numbers with units that a job writes as arithmetic, such as ``1/3``, ``1e6/10`` or ``2*(3 mm + 1 cm)``."""

import re
from functools import lru_cache

from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.units import Dimension, parse_quantity

_ARITHMETIC = re.compile(r"[*/^()]|.[+-]", re.DOTALL)


@lru_cache(1024)  # sweeps read the same quantities repeatedly
def constant(text: str) -> tuple[float, Dimension | None]:
    """Value (SI) and dimension of a number with or without a unit, or of a formula without variables.

    The dimension of a formula of plain numbers is ``None``: they are SI, as plain numbers are.

    Raises:
        ValueError: the text is neither, with the reason.
    """
    try:
        return parse_quantity(text)
    except ValueError as error:
        if not _ARITHMETIC.search(text):
            raise
        try:
            formula = Expression(text)
        except ValueError:
            raise error from None
        if formula.names:
            raise
    dimension = formula.check({})
    if dimension is None and formula.has_units:
        dimension = formula.check({}, plain=Dimension())
    if dimension is True or dimension is False:
        raise ValueError(f"'{text}' is a condition, not a number")
    return float(formula.evaluate()), dimension


def is_arithmetic(text: str) -> bool:
    """Return whether a text that `constant` reads is a formula, rather than a number with or without a unit."""
    try:
        parse_quantity(text)
    except ValueError:
        return True
    return False


def is_pure(dimension: Dimension | None) -> bool:
    """Return whether a dimension is a plain number's."""
    return dimension in (None, Dimension())
