"""Samples: points of the unit cube, and the distributions that map them to values."""

import math
import random
import statistics
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, overload

from hpcinv.base.quantity.constants import constant
from hpcinv.base.quantity.schema import shown
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.units import Dimension, as_float

type DistributionKind = Literal["uniform", "log-uniform", "normal"]
type SamplingMethod = Literal["random", "latin_hypercube", "sobol"]

_EXAMPLES: Mapping[str, str] = {
    "uniform": "[2 kPa, 200 kPa]",
    "log-uniform": "{log-uniform: [2 kPa, 200 kPa]}",
    "normal": "{normal: [963 kg/m^3, 10 kg/m^3]}",
}
_LEAST = 2.0**-53  # smallest probability; 0 would be minus infinity in a normal distribution


@dataclass(frozen=True)
class Distribution:
    """Distribution of a parameter (SI): between ``first`` and ``second``, or normal with that mean and deviation.

    ``dimension`` is ``None`` where the file has plain numbers.
    """

    kind: DistributionKind
    first: float
    second: float
    dimension: Dimension | None = None

    def quantile(self, share: float) -> float:
        """Return the quantile of a probability ``share``, rounded to 12 digits.

        Logarithms and powers differ in their last bit between the mathematical libraries of different machines. The
        key of a case is a hash of its values, and must not differ.
        """
        match self.kind:
            case "uniform":
                value = self.first + share * (self.second - self.first)
            case "log-uniform":
                value = self.first * (self.second / self.first) ** share
            case "normal":
                value = statistics.NormalDist(self.first, self.second).inv_cdf(max(share, _LEAST))
        return float(f"{value:.12g}")

    def standard(self, value: float) -> float:
        """Return where a value lies: in [-1, 1] of its range, or in standard deviations from the mean."""
        match self.kind:
            case "uniform":
                return 2 * (value - self.first) / (self.second - self.first) - 1
            case "log-uniform":
                return 2 * math.log(value / self.first) / math.log(self.second / self.first) - 1
        return (value - self.first) / self.second


def read_distribution(given: object) -> Distribution:
    """Return the distribution that a file gives by two ends, or by its kind and two numbers, with or without units.

    Raises:
        ValueError: it is not valid.
    """
    if isinstance(given, Distribution):
        return given
    kind: Any = "uniform"
    values: Any = given
    if isinstance(given, Mapping) and len(given) == 1:
        ((kind, values),) = given.items()
    if kind not in _EXAMPLES:
        raise ValueError(f"there is no distribution {shown(kind)}.{did_you_mean(str(kind), _EXAMPLES)}")
    if not isinstance(values, list | tuple) or len(values) != 2:
        what = "mean and standard deviation" if kind == "normal" else "the two ends of a range"
        raise ValueError(f"must be {what}, such as {_EXAMPLES[kind]}, not {shown(values)}")
    first, second, dimension = _same_dimension(values)
    if fault := _fault_of_numbers(kind, first, second, values):
        raise ValueError(fault)
    return Distribution(kind, first, second, dimension)


def _fault_of_numbers(kind: str, first: float, second: float, values: Sequence[object]) -> str:
    """Return what is wrong with the two numbers of a distribution, given as ``values``; "" if they are valid."""
    if kind == "normal":
        return "" if second > 0 else f"must have a standard deviation above 0, not {values[1]}"
    if not first < second:
        return f"must begin below its end, not {values[0]} and {values[1]}"
    if kind == "log-uniform" and first <= 0:
        return f"must begin above 0 to be log-uniform, not with {values[0]}"
    return ""


def _same_dimension(values: Sequence[object]) -> tuple[float, float, Dimension | None]:
    """Return two numbers or quantities in SI, and their common dimension."""
    read = []
    for value in values:
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise ValueError(f"must contain numbers or quantities, not {shown(value)}")
        read.append(constant(value) if isinstance(value, str) else (as_float(value), None))
    (first, dimension), (second, second_dimension) = read
    if dimension != second_dimension:
        raise ValueError(f"must have two values of the same dimension, not {values[0]} and {values[1]}")
    if not (math.isfinite(first) and math.isfinite(second)):
        raise ValueError(f"must contain finite numbers, not {values[0]} and {values[1]}")
    return first, second, dimension


def unit_points(method: SamplingMethod, dimensions: int, count: int, seed: int) -> Sequence[Sequence[float]]:
    """Return points in ``[0, 1)^dimensions``, the same on any machine.

    A larger random or Sobol sample begins with the points of a smaller one; a Latin hypercube has other points.

    Source: Sobol points with the directions of Joe & Kuo (2008), doi:10.1137/070709359, scrambled by Matoušek's linear
    matrices, and Latin hypercubes of McKay, Beckman & Conover (1979), doi:10.2307/1268522, as scipy.stats.qmc has them.
    """
    if method == "random":
        source = random.Random(seed)  # random() gives the same numbers in every version of Python
        return UnitPoints(array("d", (source.random() for _ in range(count * dimensions))), dimensions)

    from scipy.stats import qmc

    if method == "latin_hypercube":
        points = qmc.LatinHypercube(dimensions, rng=seed).random(count)
    else:  # samples of 2^n points are balanced
        points = qmc.Sobol(dimensions, rng=seed).random_base2((count - 1).bit_length())[:count]
    return UnitPoints(array("d", points.tobytes()), dimensions)


class UnitPoints(Sequence[Sequence[float]]):
    """Points with so many coordinates each, in an array without objects for each of them."""

    def __init__(self, coordinates: array[float], dimensions: int) -> None:
        self._coordinates, self._dimensions = coordinates, dimensions

    def __len__(self) -> int:
        return len(self._coordinates) // self._dimensions

    @overload
    def __getitem__(self, place: int) -> Sequence[float]: ...

    @overload
    def __getitem__(self, place: slice) -> Sequence[Sequence[float]]: ...

    def __getitem__(self, place: int | slice) -> Sequence[float] | Sequence[Sequence[float]]:
        if isinstance(place, slice):
            return [self[i] for i in range(*place.indices(len(self)))]
        if not 0 <= place < len(self):
            raise IndexError(place)
        return self._coordinates[place * self._dimensions : (place + 1) * self._dimensions]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, UnitPoints) and [*self] == [*other]

    __hash__ = None  # type: ignore[assignment]
