"""Coefficients of parameters of a law: numbers decide which terms a form has, symbols are part of the form."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from typing import Any

from hpcinv.physics.materials.formula_law.algebras import Functions

_ROUNDING = 1e-13  # a sum that is smaller than this part of its terms is zero

_recorded: ContextVar[list[bool] | None] = ContextVar("recorded decisions", default=None)


@contextmanager
def recorded_decisions() -> Iterator[list[bool]]:
    """Context that records all decisions that the values of coefficients make about terms of a form, in order."""
    decisions: list[bool] = []
    token = _recorded.set(decisions)
    try:
        yield decisions
    finally:
        _recorded.reset(token)


def _decided(outcome: bool) -> bool:
    if (decisions := _recorded.get()) is not None:
        decisions.append(outcome)
    return outcome


@dataclass(frozen=True)
class Coefficient:
    """A number and its symbol in forms, so that a form is the same for other values.

    A sum that vanishes except for rounding errors is exactly zero, such as ``k*3 + (1 - 3*k) - 1``.

    Args:
        symbol: the number, or a UFL scalar in its place.
        size: sum of the magnitudes of its terms.
        is_literal: whether it depends on no parameter.
    """

    value: float
    symbol: Any
    size: float
    is_literal: bool

    @classmethod
    def literal(cls, value: float) -> Coefficient:
        return cls(value, value, abs(value), is_literal=True)

    @classmethod
    def parameter(cls, value: float, symbol: Any) -> Coefficient:
        """Return the coefficient of a parameter; a zero is literal, so that its term is not in the form."""
        return cls(value, symbol, abs(value), is_literal=False) if _decided(value != 0) else ZERO

    def __bool__(self) -> bool:
        return _decided(self.value != 0)

    @property
    def is_positive(self) -> bool:
        return _decided(self.value > 0)

    def __add__(self, other: Coefficient) -> Coefficient:
        return self._combined(other, self.value + other.value, self.symbol + other.symbol, self.size + other.size)

    def __sub__(self, other: Coefficient) -> Coefficient:
        return self + -other

    def __neg__(self) -> Coefficient:
        return replace(self, value=-self.value, symbol=-self.symbol)

    def __mul__(self, other: Coefficient) -> Coefficient:
        return self._combined(other, self.value * other.value, self.symbol * other.symbol, self.size * other.size)

    def __truediv__(self, other: Coefficient) -> Coefficient:
        if not other:
            raise ValueError("divides by zero")
        size = self.size / abs(other.value) * (other.size / abs(other.value))
        return self._combined(other, self.value / other.value, self.symbol / other.symbol, size)

    def __pow__(self, exponent: Coefficient) -> Coefficient:
        if self.value < 0 and not exponent.value.is_integer():
            raise ValueError(f"raises a negative number to the power {exponent.value:g}")
        if not self and exponent.value <= 0:
            raise ValueError(f"raises zero to the power {exponent.value:g}")
        if not self:
            return ZERO
        value = self.value**exponent.value
        return self._combined(exponent, value, self.symbol**exponent.symbol, abs(value) * self.size / abs(self.value))

    def apply(self, name: str, functions: Functions, slope: float = 1.0) -> Coefficient:
        """Return a function of the coefficient by name; ``slope`` is the size of its derivative, or a bound of it."""
        try:
            value = getattr(math, name)(self.value)
        except ValueError:
            raise ValueError(f"calls {name}() of {self.value:g}, where it has no value") from None
        symbol = value if self.is_literal else functions[name](self.symbol)
        return self._combined(self, value, symbol, abs(value) + slope * self.size)

    def _combined(self, other: Coefficient, value: float, symbol: Any, size: float) -> Coefficient:
        if _decided(abs(value) <= _ROUNDING * size):
            return ZERO
        return Coefficient(value, symbol, size, self.is_literal and other.is_literal)


ZERO = Coefficient.literal(0.0)
ONE = Coefficient.literal(1.0)
