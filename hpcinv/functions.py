"""The functions and constants that formulas in job files know."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, reduce
from typing import Any

from hpcinv.measures import RELATIONS, pure, same, square_root

CONSTANTS = {"pi": math.pi}


@dataclass(frozen=True)
class Function:
    """A function that formulas may call.

    Args:
        ufunc: its name in NumPy; functions of many arguments are reductions of it.
        measure: the dimension of its value from those of its arguments.
        arguments: their number; None means two or more.
    """

    ufunc: str
    measure: Callable[..., Any] = pure
    arguments: int | None = 1


FUNCTIONS = {
    **{name: Function(name) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log")},
    **{f"a{name}": Function(f"arc{name}") for name in ("sin", "cos", "tan")},
    "ln": Function("log"),
    "atan2": Function("arctan2", lambda y, x: pure(same(y, x) / same(y, x)), 2),
    "sqrt": Function("sqrt", square_root),
    "abs": Function("absolute", same),
    "min": Function("minimum", same, None),
    "max": Function("maximum", same, None),
    "norm": Function("hypot", same, None),
}


@cache
def numpy_functions() -> dict[str, Callable[..., Any]]:
    """Every function of formulas, and the relations, on arrays."""
    import numpy as np

    def named(f: Function) -> Callable[..., Any]:
        ufunc: Callable[..., Any] = getattr(np, f.ufunc)
        return ufunc if f.arguments else lambda *arguments: reduce(ufunc, arguments)

    return {name: named(f) for name, f in FUNCTIONS.items()} | {name: getattr(np, name) for name in RELATIONS}
