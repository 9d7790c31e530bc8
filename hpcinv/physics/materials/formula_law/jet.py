"""Jets: values of formulas, split so that first-order terms cancel exactly at small strain.

A jet ``q = q0 + Σ q1[a] t[a] + R`` stores its parts separately. The strains ``t[a]``, such as ``tr E``, are small of
first order; the remainder ``R``, of second and higher order, is computed without subtraction of large numbers. An
energy that is stress-free at ``F = I`` has no ``q1``, and only ``R`` has a derivative.

A Taylor model has a bound instead of the remainder: Berz & Makino (1998), doi:10.1023/A:1024467732637.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from typing import Any

from hpcinv.base.quantity.functions import FUNCTIONS
from hpcinv.physics.materials.formula_law.algebras import Functions
from hpcinv.physics.materials.formula_law.coefficients import ONE, ZERO, Coefficient


@dataclass
class Strains:
    """Strains and functions of the jets of one formula.

    Args:
        functions: functions of strains and remainders, see `hpcinv.physics.materials.formula_law.algebras`.

    Attributes:
        values: the strains ``t`` by name.
        positive: scalars that are positive where the formula has a value, divided by their values at ``F = I``.
    """

    functions: Functions
    values: dict[str, Any] = field(default_factory=dict)
    positive: list[Any] = field(default_factory=list)

    def constant(self, value: Coefficient) -> Jet:
        return Jet(self, value, {}, 0.0, math.inf, is_positive=value.is_positive)

    def number(self, value: float) -> Jet:
        return self.constant(Coefficient.literal(value))


@dataclass(frozen=True, eq=False)
class Jet:
    """A scalar that depends on strains.

    Args:
        constant: ``q0``, its value at ``F = I``.
        slopes: ``q1`` by the name of the strain, without zeros.
        remainder: ``R``.
        order: ``R = O(t^order)``: 2 if it is smooth, 1 if it has a kink at ``F = I``, infinity if it is constant.
        is_positive: whether it is positive for every deformation.
        exact_change: ``q - q0``, if it is known more directly than as the sum of its parts.

    Raises:
        ValueError: by operators that have no value or no derivative at ``F = I``.
    """

    strains: Strains
    constant: Coefficient
    slopes: Mapping[str, Coefficient]
    remainder: Any
    order: float
    is_positive: bool = False
    exact_change: Any = None

    @property
    def is_constant(self) -> bool:
        return self.order == math.inf

    @cached_property
    def first_order(self) -> Any:
        """``Σ q1[a] t[a]``."""
        return sum((q.symbol * self.strains.values[name] for name, q in self.slopes.items()), 0.0)

    @cached_property
    def change(self) -> Any:
        """``q - q0``."""
        return self.first_order + self.remainder if self.exact_change is None else self.exact_change

    @property
    def order_of_change(self) -> float:
        return 1 if self.slopes else self.order

    @cached_property
    def relative_change(self) -> Any:
        """``q/q0 - 1``; that it is above -1 is added to the conditions in `Strains`."""
        relative = self.change / self.constant.symbol
        if not self.is_positive and not self.is_constant:
            self.strains.positive.append(1 + relative)
        return relative

    def __neg__(self) -> Jet:
        return self * self.strains.number(-1.0)

    def __sub__(self, other: Jet) -> Jet:
        return self + -other

    def __add__(self, other: Jet) -> Jet:
        return Jet(
            self.strains,
            self.constant + other.constant,
            _sum(self.slopes, other.slopes),
            self.remainder + other.remainder,
            min(self.order, other.order),
            self.is_positive and other.is_positive,
        )

    def __mul__(self, other: Jet) -> Jet:
        q, s = self.constant, other.constant
        return Jet(
            self.strains,
            q * s,
            _sum(_times(s, self.slopes), _times(q, other.slopes)),
            q.symbol * other.remainder + s.symbol * self.remainder + self.change * other.change,
            min(
                other.order if q else math.inf,
                self.order if s else math.inf,
                self.order_of_change + other.order_of_change,
            ),
            self.is_positive and other.is_positive,
        )

    def __truediv__(self, other: Jet) -> Jet:
        if not other.constant:
            raise ValueError("divides by something that is 0 at F = I")
        q = self.constant / other.constant
        rest = self - self.strains.constant(q) * other  # f/g = q + rest/g, and the rest has no constant part
        relative = other.relative_change
        return Jet(
            self.strains,
            q,
            _times(ONE / other.constant, rest.slopes),
            (rest.remainder - rest.first_order * relative) / (1 + relative) / other.constant.symbol,
            min(rest.order, rest.order_of_change + other.order_of_change),
            self.is_positive and other.is_positive,
        )

    def __pow__(self, exponent: Jet) -> Jet:
        n = exponent.constant
        if not exponent.is_constant:
            return exp(exponent * ln(self))
        if self.is_constant:
            return self.strains.constant(self.constant**n)
        if n.is_literal and n.value.is_integer():
            if abs(n.value) > _MOST_FACTORS:
                raise ValueError(f"raises a strain to the power {n.value:g}, and the largest is {_MOST_FACTORS}")
            return self._whole_power(int(n.value))
        if self.constant.is_positive:
            return self._power(n)
        if self.constant:
            raise ValueError(f"raises something that is negative at F = I to the power {n.value:g}")
        order = n.value * self.order_of_change
        if self.slopes or order < 2:
            remedy = "write a whole number, or max(…, 0) with a power of 2 or more"
            raise ValueError(f"raises something that is 0 at F = I to the power {n.value:g}; {remedy}")
        base = self.remainder
        power = self.strains.functions["if_positive"](base, base**n.symbol, 0.0)
        return Jet(self.strains, ZERO, {}, power, order)

    def _whole_power(self, n: int) -> Jet:
        if n < 0:
            return self.strains.number(1.0) / self._whole_power(-n)
        if n < 2:
            return self if n else self.strains.number(1.0)
        root = self._whole_power(n // 2)
        return root * root * self if n % 2 else root * root

    def _power(self, n: Coefficient) -> Jet:
        value = self.constant**n
        further = value.symbol * self.strains.functions["power_remainder"](self.relative_change, n.symbol)
        return self.mapped(value, n * value / self.constant, further, self.is_positive)

    def mapped(self, value: Coefficient, slope: Coefficient, further: Any, is_positive: bool = False) -> Jet:
        """Return ``f(q)``, from ``f(q0)``, ``f'(q0)`` and the remainder of ``f`` after its tangent."""
        return Jet(
            self.strains,
            value,
            _times(slope, self.slopes),
            slope.symbol * self.remainder + further,
            self.order if self.is_constant else min(self.order, 2),
            is_positive,
        )

    def second_order_change(
        self, value: Coefficient, change: str, argument: Any, factor: Coefficient, is_positive: bool = False
    ) -> Jet:
        """Return ``f(q) = f(q0) + factor · change(of)``, if the change has no first-order part."""
        if self.is_constant:
            return replace(self.strains.constant(value), is_positive=is_positive or value.is_positive)
        remainder = factor.symbol * self.strains.functions[change](argument)
        return Jet(self.strains, value, {}, remainder, min(self.order, 2), is_positive)


_MOST_FACTORS = 1000  # of a power, which becomes products; a strain to this power has no value near F = I


def _times(factor: Coefficient, slopes: Mapping[str, Coefficient]) -> dict[str, Coefficient]:
    return {name: factor * q for name, q in slopes.items() if factor}


def _sum(first: Mapping[str, Coefficient], second: Mapping[str, Coefficient]) -> dict[str, Coefficient]:
    total = {name: first.get(name, ZERO) + second.get(name, ZERO) for name in {**first, **second}}
    return {name: q for name, q in total.items() if q}


def exp(q: Jet) -> Jet:
    value = q.constant.apply("exp", q.strains.functions, slope=math.exp(q.constant.value))
    if not q.slopes:
        return q.second_order_change(value, "expm1", q.remainder, value, is_positive=True)
    further = value.symbol * q.strains.functions["expm1_remainder"](q.change)
    return q.mapped(value, value, further, is_positive=True)


def ln(q: Jet) -> Jet:
    if q.constant.value <= 0:
        raise ValueError("takes the logarithm of something that is not positive at F = I")
    value = q.constant.apply("log", q.strains.functions, slope=1 / q.constant.value)
    if not q.slopes:
        return q.second_order_change(value, "log1p", q.relative_change, ONE)
    return q.mapped(value, ONE / q.constant, q.strains.functions["log1p_remainder"](q.relative_change))


def sqrt(q: Jet) -> Jet:
    if q.is_constant:
        return q ** q.strains.number(0.5)
    if q.constant.value <= 0:
        raise ValueError("takes the square root of something that is not positive at F = I")
    value = q.constant.apply("sqrt", q.strains.functions, slope=1 / math.sqrt(q.constant.value))
    x = q.relative_change
    further = -value.symbol * x**2 / (2 * (1 + q.strains.functions["sqrt"](1 + x)) ** 2)
    return q.mapped(value, Coefficient.literal(0.5) / value, further, q.is_positive)


def positive_part(q: Jet) -> Jet:
    if q.is_constant:
        return q if q.constant.is_positive else q.strains.number(0.0)
    if_positive = q.strains.functions["if_positive"]
    value = q.constant.symbol + q.change
    if q.constant.is_positive:
        rest = if_positive(value, q.remainder, -(q.constant.symbol + q.first_order))
        return replace(q, remainder=rest, exact_change=None)
    return Jet(q.strains, ZERO, {}, if_positive(value, value, 0.0), 2 if q.constant else q.order_of_change)


def _tanh(q: Jet) -> Jet:
    unit, two = q.strains.number(1.0), q.strains.number(2.0)
    return unit - two / (exp(two * q) + unit)


def _constant_function(name: str) -> Callable[..., Jet]:
    def function(q: Jet, *others: Jet) -> Jet:
        if others or not q.is_constant:
            raise ValueError(f"calls {name}(), which energies know of a constant only")
        return q.strains.constant(q.constant.apply(name, q.strains.functions))

    return function


JET_FUNCTIONS: dict[str, Callable[..., Jet]] = {
    **{name: _constant_function(name) for name in FUNCTIONS},
    "exp": exp,
    "log": ln,
    "ln": ln,
    "sqrt": sqrt,
    "sinh": lambda q: (exp(q) - exp(-q)) * q.strains.number(0.5),
    "cosh": lambda q: (exp(q) + exp(-q)) * q.strains.number(0.5),
    "tanh": _tanh,
    "abs": lambda q: q if q.is_positive else positive_part(q) + positive_part(-q),
    "min": lambda *terms: reduce(lambda a, b: a - positive_part(a - b), terms),
    "max": lambda *terms: reduce(lambda a, b: b + positive_part(a - b), terms),
    "norm": lambda *terms: sqrt(reduce(operator.add, (t * t for t in terms))),
}
"""The functions that formulas may call, of jets."""
