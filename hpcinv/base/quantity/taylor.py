"""Numbers with first and second derivatives of the formulas of energies and surfaces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from hpcinv.base.quantity.arrays import Floats


@dataclass(frozen=True, eq=False)
class Taylor:
    """Values (n,) of a function of m variables, with gradients (n, m) and Hessians (n, m, m)."""

    value: Floats
    gradient: Floats
    hessian: Floats

    __array_ufunc__ = None  # so that NumPy leaves its operators to this class

    @classmethod
    def variable(cls, value: Floats, number: int, count: int) -> Taylor:
        """Return the values (n,) of variable ``number`` of ``count``."""
        gradient = np.zeros((len(value), count))
        gradient[:, number] = 1.0
        return cls(value, gradient, np.zeros((len(value), count, count)))

    def mapped(self, f: Any, first: Any, second: Any) -> Taylor:
        """Return a function of this number, from its value and its derivatives by it (n,)."""
        first, second = np.asarray(first)[..., None], np.asarray(second)[..., None, None]
        outer = self.gradient[:, :, None] * self.gradient[:, None, :]
        return Taylor(f, first * self.gradient, first[..., None] * self.hessian + second * outer)

    def __neg__(self) -> Taylor:
        return Taylor(-self.value, -self.gradient, -self.hessian)

    def __pos__(self) -> Taylor:
        return self

    def __add__(self, other: Taylor | float) -> Taylor:
        if not isinstance(other, Taylor):
            return Taylor(self.value + other, self.gradient, self.hessian)
        return Taylor(self.value + other.value, self.gradient + other.gradient, self.hessian + other.hessian)

    def __sub__(self, other: Taylor | float) -> Taylor:
        return self + -other

    def __rsub__(self, other: float) -> Taylor:
        return -self + other

    def __mul__(self, other: Taylor | float) -> Taylor:
        if not isinstance(other, Taylor):
            return Taylor(self.value * other, self.gradient * other, self.hessian * other)
        a, b = self.value[:, None], other.value[:, None]
        mixed = self.gradient[:, :, None] * other.gradient[:, None, :]
        return Taylor(
            self.value * other.value,
            a * other.gradient + b * self.gradient,
            a[..., None] * other.hessian + b[..., None] * self.hessian + mixed + mixed.transpose(0, 2, 1),
        )

    def __truediv__(self, other: Taylor | float) -> Taylor:
        return self * other**-1.0

    def __rtruediv__(self, other: float) -> Taylor:
        return self**-1.0 * other

    def __pow__(self, exponent: Taylor | float) -> Taylor:
        if isinstance(exponent, Taylor):
            power: Taylor = exp(exponent * log(self))
            return power
        v, n = self.value, float(exponent)
        # 0 times an infinite power is 0 here: x**1 is linear at 0, too
        first = n * v ** (n - 1) if n else np.zeros_like(v)
        second = n * (n - 1) * v ** (n - 2) if n * (n - 1) else np.zeros_like(v)
        return self.mapped(v**n, first, second)

    def __rpow__(self, base: float) -> Taylor:
        power: Taylor = exp(self * float(np.log(base)))
        return power

    __radd__ = __add__
    __rmul__ = __mul__


type TaylorOrFloat = Taylor | float


def _function(derivatives: Callable[[Any], tuple[Any, Any, Any]]) -> Callable[[TaylorOrFloat], Any]:
    """Return a function of Taylor numbers and floats from its value and derivatives."""
    return lambda x: x.mapped(*derivatives(x.value)) if isinstance(x, Taylor) else derivatives(np.float64(x))[0]


exp = _function(lambda v: (np.exp(v),) * 3)
log = _function(lambda v: (np.log(v), 1 / v, -1 / v**2))
sqrt = _function(lambda v: (np.sqrt(v), 0.5 / np.sqrt(v), -0.25 / (np.sqrt(v) * v)))
_sin = _function(lambda v: (np.sin(v), np.cos(v), -np.sin(v)))
_cos = _function(lambda v: (np.cos(v), -np.sin(v), -np.cos(v)))
_sinh = _function(lambda v: (np.sinh(v), np.cosh(v), np.sinh(v)))
_cosh = _function(lambda v: (np.cosh(v), np.sinh(v), np.cosh(v)))
_abs = _function(lambda v: (np.abs(v), np.sign(v), np.zeros_like(v)))
_atan = _function(lambda v: (np.arctan(v), 1 / (1 + v**2), -2 * v / (1 + v**2) ** 2))


def _larger(a: TaylorOrFloat, b: TaylorOrFloat) -> TaylorOrFloat:
    larger: TaylorOrFloat = (a + b + _abs(a - b)) * 0.5
    return larger


def _norm(*terms: TaylorOrFloat) -> TaylorOrFloat:
    norm: TaylorOrFloat = sqrt(sum(t * t for t in terms))
    return norm


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "exp": exp,
    "log": log,
    "ln": log,
    "sqrt": sqrt,
    "abs": _abs,
    "sin": _sin,
    "cos": _cos,
    "tan": lambda x: _sin(x) / _cos(x),
    "asin": _function(lambda v: (np.arcsin(v), (1 - v**2) ** -0.5, v * (1 - v**2) ** -1.5)),
    "acos": _function(lambda v: (np.arccos(v), -((1 - v**2) ** -0.5), -v * (1 - v**2) ** -1.5)),
    "atan": _atan,
    "atan2": lambda y, x: _atan(y / (_norm(x, y) + x)) * 2,
    "sinh": _sinh,
    "cosh": _cosh,
    "tanh": lambda x: _sinh(x) / _cosh(x),
    "max": lambda *terms: reduce(_larger, terms),
    "min": lambda *terms: -reduce(_larger, [-t for t in terms]),
    "norm": _norm,
}
"""The functions that formulas may call, of Taylor numbers and of floats."""
