"""Dimensional analysis: the dimension of a formula, found by evaluating it with `TermDimension` instead of numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hpcinv.base.quantity.units import Dimension


class Condition:
    """Result of a comparison; it has no arithmetic."""


@dataclass(frozen=True)
class TermDimension:
    """Dimension of a term, ``None`` if plain numbers leave it undetermined; ``number`` is the value of a literal."""

    dimension: Dimension | None
    number: float | None = None

    def __add__(self, other: TermDimension) -> TermDimension:
        return same(self, other)

    __sub__ = __add__

    def __mul__(self, other: TermDimension) -> TermDimension:
        return self._combine(other, 1)

    def __truediv__(self, other: TermDimension) -> TermDimension:
        return self._combine(other, -1)

    def __pow__(self, exponent: TermDimension) -> TermDimension:
        pure(exponent)
        if self.dimension is None or exponent.number is None:
            return TermDimension(Dimension() if self.dimension == Dimension() else None)
        powers = [n * exponent.number for n in self.dimension]
        return TermDimension(Dimension(*map(int, powers)) if all(p.is_integer() for p in powers) else None)

    def __neg__(self) -> TermDimension:
        return TermDimension(self.dimension, None if self.number is None else -self.number)

    def __pos__(self) -> TermDimension:
        return self

    def _combine(self, other: TermDimension, sign: int) -> TermDimension:
        theirs = _measure(other).dimension
        if self.dimension is None or theirs is None:
            return TermDimension(None)
        return TermDimension(Dimension(*(a + sign * b for a, b in zip(self.dimension, theirs, strict=True))))


def same(*terms: TermDimension) -> TermDimension:
    """Common dimension of terms that are added or compared; ``ValueError`` if their dimensions differ."""
    known = [_measure(t).dimension for t in terms if _measure(t).dimension is not None]
    for dimension in known:
        if dimension != known[0]:
            raise ValueError(f"adds or compares {known[0]} and {dimension}")
    return TermDimension(known[0] if known else None)


def pure(argument: TermDimension) -> TermDimension:
    """Dimension of a function of a pure number; ``ValueError`` if the argument has a dimension."""
    if _measure(argument).dimension not in (None, Dimension()):
        raise ValueError(f"needs a pure number where it has {argument.dimension}")
    return TermDimension(Dimension())


def square_root(argument: TermDimension) -> TermDimension:
    """Dimension of a square root."""
    return _measure(argument) ** TermDimension(None, 0.5)


def _measure(term: Any) -> TermDimension:
    if not isinstance(term, TermDimension):
        raise TypeError(term)
    return term


def _compare(left: TermDimension, right: TermDimension) -> Condition:
    same(left, right)
    return Condition()


def _combine(*terms: Condition) -> Condition:
    if not all(isinstance(t, Condition) for t in terms):
        raise TypeError(terms)
    return Condition()


RELATIONS: dict[str, Callable[..., Condition]] = {
    **dict.fromkeys(("less", "less_equal", "greater", "greater_equal"), _compare),
    **dict.fromkeys(("logical_and", "logical_or", "logical_not"), _combine),
}
