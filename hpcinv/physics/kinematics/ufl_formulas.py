"""Formulas of job files as UFL expressions of position."""

from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any

import ufl
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives

from hpcinv.base.quantity.expressions import Expression
from hpcinv.physics.kinematics.kinematics import Kinematics, OtherState
from hpcinv.physics.kinematics.staged_derivatives import remove_stages

UFL_FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{name: getattr(ufl, name) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "asin", "acos", "atan")},
    "exp": ufl.exp,
    "log": ufl.ln,
    "ln": ufl.ln,
    "sqrt": ufl.sqrt,
    "abs": abs,
    "atan2": ufl.atan2,
    "min": lambda *terms: reduce(ufl.min_value, terms),
    "max": lambda *terms: reduce(ufl.max_value, terms),
    "norm": lambda *terms: ufl.sqrt(sum(t * t for t in terms)),
}
"""Functions in formulas."""


def position_formula(formula: Expression, k: Kinematics | OtherState, metre: Any, constants: Mapping[str, Any]) -> Any:
    """Return a formula of ``X, Y, Z`` (reference) and ``x, y, z`` (current) in SI, at each point of the body.

    Args:
        metre: SI value of the scaled unit of length.
        constants: values of further names.
    """
    positions = {name: (k.X, i) for i, name in enumerate("XYZ")} | {name: (k.x, i) for i, name in enumerate("xyz")}
    values = {name: metre * positions[name][0][positions[name][1]] for name in formula.names & positions.keys()}
    return formula.apply(values | dict(constants), UFL_FUNCTIONS)


def value_and_gradient(formula: Expression, position: Any) -> tuple[Any, Any]:
    """Return a formula of ``x, y, z`` at a position (UFL vector, SI) and its gradient, without UFL variables."""
    variable = ufl.variable(position)
    value = formula.apply({name: variable[i] for i, name in enumerate("xyz")}, UFL_FUNCTIONS)
    slope = apply_derivatives(apply_algebra_lowering(ufl.diff(value, variable)))
    return remove_stages(value), remove_stages(slope)
