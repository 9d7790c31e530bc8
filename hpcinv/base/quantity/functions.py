"""Functions and constants of formulas in job files."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, reduce
from typing import Any

from hpcinv.base.quantity.dimensional_analysis import RELATIONS, pure, same, square_root

CONSTANTS = {"pi": math.pi}


@dataclass(frozen=True)
class Function:
    """A function in formulas.

    Args:
        ufunc: name in NumPy; functions of two or more arguments are reductions of it.
        measure: dimension of the value from the dimensions of the arguments.
        arguments: number of arguments; None for two or more.
    """

    meaning: str
    ufunc: str
    measure: Callable[..., Any] = pure
    arguments: int | None = 1


FUNCTIONS = {
    "sin": Function("sine of an angle in rad (or with a unit, such as 30 deg)", "sin"),
    "cos": Function("cosine of an angle in rad", "cos"),
    "tan": Function("tangent of an angle in rad", "tan"),
    "asin": Function("arcsine, in rad", "arcsin"),
    "acos": Function("arccosine, in rad", "arccos"),
    "atan": Function("arctangent, in rad", "arctan"),
    "atan2": Function(
        "angle of the point (second, first) from the first axis, in rad from -pi to pi: atan2(y, x)",
        "arctan2",
        lambda y, x: pure(same(y, x) / same(y, x)),
        2,
    ),
    "sinh": Function("hyperbolic sine", "sinh"),
    "cosh": Function("hyperbolic cosine", "cosh"),
    "tanh": Function("hyperbolic tangent", "tanh"),
    "exp": Function("exponential function", "exp"),
    "log": Function("natural logarithm", "log"),
    "ln": Function("natural logarithm", "log"),
    "sqrt": Function("square root", "sqrt", square_root),
    "abs": Function("absolute value", "absolute", same),
    "min": Function("smallest of the values", "minimum", same, None),
    "max": Function("largest of the values", "maximum", same, None),
    "norm": Function(
        "square root of the sum of squares: norm(x, y, z) is the distance from the origin", "hypot", same, None
    ),
}


@cache
def numpy_functions() -> dict[str, Callable[..., Any]]:
    """All functions and relations of formulas, on NumPy arrays."""
    import numpy as np

    def named(f: Function) -> Callable[..., Any]:
        ufunc: Callable[..., Any] = getattr(np, f.ufunc)
        return ufunc if f.arguments else lambda *arguments: reduce(ufunc, arguments)

    return {name: named(f) for name, f in FUNCTIONS.items()} | {name: getattr(np, name) for name in RELATIONS}
