"""Functions of the numbers in jets: of floats, to check an energy, and of UFL scalars, to build forms.

Besides the functions of formulas, these are ``if_positive(x, then, otherwise)``, ``log1p``, ``expm1`` and remainders of
functions after subtraction of their tangent: ``log1p_remainder(x) = ln(1 + x) - x``,
``expm1_remainder(x) = exp(x) - 1 - x`` and ``power_remainder(x, n) = (1 + x)^n - 1 - n x``.
"""

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

type Functions = Mapping[str, Callable[..., Any]]

FLOATS: Functions = {
    **{name: getattr(math, name) for name in ("exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan")},
    "if_positive": lambda x, then, otherwise: then if x > 0 else otherwise,
    "log1p": math.log1p,
    "expm1": math.expm1,
    "log1p_remainder": lambda x: math.log1p(x) - x,
    "expm1_remainder": lambda x: math.expm1(x) - x,
    "power_remainder": lambda x, n: math.expm1(n * math.log1p(x)) - n * x,
}
"""Functions of floats; remainders have a relative error of ``1e-16/x``, enough for moduli from differences."""


@cache
def ufl_functions() -> Functions:
    """Return functions of UFL scalars, accurate at small arguments together with their derivatives."""
    import ufl

    from hpcinv.physics.kinematics.stable_functions import (
        expm1,
        expm1_remainder,
        log1p,
        log1p_remainder,
        power_remainder,
    )
    from hpcinv.physics.kinematics.ufl_formulas import UFL_FUNCTIONS

    return {
        **UFL_FUNCTIONS,
        "if_positive": lambda x, then, otherwise: ufl.conditional(ufl.gt(x, 0), then, otherwise),
        "log1p": log1p,
        "expm1": expm1,
        "log1p_remainder": log1p_remainder,
        "expm1_remainder": expm1_remainder,
        "power_remainder": power_remainder,
    }
