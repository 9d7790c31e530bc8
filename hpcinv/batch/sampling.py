"""Samples: points of the unit cube, and the distributions that they become values of."""

from __future__ import annotations

import math
import random
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from hpcinv.quantity.schema import shown
from hpcinv.quantity.suggestions import did_you_mean
from hpcinv.quantity.units import Dimension, as_float, parse_quantity

type Kind = Literal["uniform", "log-uniform", "normal"]
type Method = Literal["random", "latin_hypercube", "sobol"]

_EXAMPLES: Mapping[str, str] = {
    "uniform": "[2 kPa, 200 kPa]",
    "log-uniform": "{log-uniform: [2 kPa, 200 kPa]}",
    "normal": "{normal: [963 kg/m^3, 10 kg/m^3]}",
}
_LEAST = 2.0**-53  # a share of nothing would be minus infinity in a normal distribution


@dataclass(frozen=True)
class Distribution:
    """Of one parameter, in SI: between ``first`` and ``second``, or normal with that mean and standard deviation.

    ``dimension`` is that of its units, ``None`` where the file has plain numbers.
    """

    kind: Kind
    first: float
    second: float
    dimension: Dimension | None = None

    def quantile(self, share: float) -> float:
        """The value that ``share`` of all values lie below, to 12 digits.

        Logarithms and powers differ in their last bit between the mathematical libraries of different machines. The
        identity of a case is a hash of its values, and must not.
        """
        match self.kind:
            case "uniform":
                value = self.first + share * (self.second - self.first)
            case "log-uniform":
                value = self.first * (self.second / self.first) ** share
            case "normal":
                value = statistics.NormalDist(self.first, self.second).inv_cdf(max(share, _LEAST))
        return float(f"{value:.12g}")


def read_distribution(given: object) -> Distribution:
    """A distribution as the file has it: two ends, or the name of its kind and two numbers, with or without units.

    Raises:
        ValueError: it is none.
    """
    if isinstance(given, Distribution):
        return given
    kind: Any = "uniform"
    values: Any = given
    if isinstance(given, Mapping) and len(given) == 1:
        kind, values = next(iter(given.items()))
    if kind not in _EXAMPLES:
        raise ValueError(f"there is no distribution {shown(kind)}.{did_you_mean(str(kind), _EXAMPLES)}")
    if not isinstance(values, list | tuple) or len(values) != 2:
        what = "mean and standard deviation" if kind == "normal" else "the two ends of a range"
        raise ValueError(f"must be {what}, such as {_EXAMPLES[kind]}, not {shown(values)}")
    first, second, dimension = _same_dimension(values)
    if kind == "normal" and not second > 0:
        raise ValueError(f"must have a standard deviation above 0, not {values[1]}")
    if kind != "normal" and not first < second:
        raise ValueError(f"must begin below its end, not {values[0]} and {values[1]}")
    if kind == "log-uniform" and first <= 0:
        raise ValueError(f"must begin above 0 to be log-uniform, not with {values[0]}")
    return Distribution(kind, first, second, dimension)


def _same_dimension(values: Sequence[object]) -> tuple[float, float, Dimension | None]:
    """Two numbers or quantities in SI, and of what dimension both are."""
    read = []
    for value in values:
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise ValueError(f"must have numbers or quantities in it, not {shown(value)}")
        read.append(parse_quantity(value) if isinstance(value, str) else (as_float(value), None))
    (first, one), (second, other) = read
    if one != other:
        raise ValueError(f"must have two values of the same dimension, not {values[0]} and {values[1]}")
    if not (math.isfinite(first) and math.isfinite(second)):
        raise ValueError(f"must have finite numbers in it, not {values[0]} and {values[1]}")
    return first, second, one


def unit_points(method: Method, dimensions: int, count: int, seed: int) -> Sequence[Sequence[float]]:
    """Points in ``[0, 1)^dimensions``, the same on any machine.

    With more of them random and Sobol points begin with the same ones; those of a Latin hypercube are all others.

    Source: Sobol points with the directions of Joe & Kuo (2008), doi:10.1137/070709359, scrambled by Matoušek's linear
    matrices, and Latin hypercubes of McKay, Beckman & Conover (1979), doi:10.2307/1268522, as scipy.stats.qmc has them.
    """
    if method == "random":
        source = random.Random(seed)  # its random() gives the same numbers in every version of Python
        return [[source.random() for _ in range(dimensions)] for _ in range(count)]

    from scipy.stats import qmc

    points: list[list[float]]
    if method == "latin_hypercube":
        points = qmc.LatinHypercube(dimensions, rng=seed).random(count).tolist()
    else:  # powers of two, which are balanced; the first of them where fewer are asked for
        points = qmc.Sobol(dimensions, rng=seed).random_base2((count - 1).bit_length())[:count].tolist()
    return points
