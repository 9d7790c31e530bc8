"""Scalar stress measures that formulas of quantities can use in addition to the components of the Cauchy stress.

A measure is a function whose arguments are named after the components that it needs; `measure` makes it available in
job files, units, tables and ``hpcinv formulas``.
"""

import inspect
from collections.abc import Callable
from typing import Any

COMPONENTS = {"sxx": (0, 0), "syy": (1, 1), "szz": (2, 2), "sxy": (0, 1), "syz": (1, 2), "sxz": (0, 2)}
"""row and column of each component in the stress tensor"""
MEASURES: dict[str, Callable[..., Any]] = {}
"""measures by their names in formulas"""


def measure(name: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Register a function as the measure ``name``."""

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        MEASURES[name] = function
        return function

    return register


@measure("p")
def pressure(sxx: Any, syy: Any, szz: Any) -> Any:
    """``-tr σ/3``."""
    return -(sxx + syy + szz) / 3


@measure("von_mises")
def von_mises(sxx: Any, syy: Any, szz: Any, sxy: Any, syz: Any, sxz: Any) -> Any:
    """``√(3/2 dev σ : dev σ)``."""
    p = pressure(sxx, syy, szz)
    normal = (sxx + p) ** 2 + (syy + p) ** 2 + (szz + p) ** 2
    return (1.5 * normal + 3 * (sxy**2 + syz**2 + sxz**2)) ** 0.5


PRESTRAIN = "prestrain_"
"""prefix of the components and measures of the stress that prestrain alone causes"""
PRESTRAIN_STRESSES = tuple(PRESTRAIN + name for name in (*COMPONENTS, *MEASURES))
PRESTRAIN_COMPONENTS = {f"F0{a}{b}": (i, j) for i, a in enumerate("xyz") for j, b in enumerate("xyz")}
"""row and column of each component in the stress-free stretch F0"""


def measure_named(name: str) -> Callable[..., Any] | None:
    """Return a measure of the total stress or of the prestrain's stress; ``None`` if the name is neither."""
    return MEASURES.get(name.removeprefix(PRESTRAIN))


def components_of(measure: str) -> tuple[str, ...]:
    """Names of the components that a measure needs, in the order of its arguments."""
    prefix = PRESTRAIN if measure.startswith(PRESTRAIN) else ""
    return tuple(prefix + name for name in inspect.signature(MEASURES[measure.removeprefix(prefix)]).parameters)
