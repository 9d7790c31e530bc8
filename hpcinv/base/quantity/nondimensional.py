"""Scales of the dimensionless problem, which make results and iteration counts independent of units."""

import math
from dataclasses import dataclass

from hpcinv.base.quantity.units import Dimension


@dataclass(frozen=True)
class Scales:
    """Units of length (m), stress (Pa) and time (s) of the scaled problem; powers of two, so that scaling is exact.

    Temperatures (K) are not scaled.
    """

    length: float
    stress: float
    time: float = 1.0

    def unit_of(self, dimension: Dimension) -> float:
        """SI value of one scaled unit of a quantity of this dimension."""
        mass = self.stress * self.length * self.time**2
        return float(self.length**dimension.length * mass**dimension.mass * self.time**dimension.time)


class LengthsOfBody(float):
    """A length in lengths of the body, which is not known before the mesh is."""


def power_of_two(value: float) -> float:
    """Nearest power of two of a positive value."""
    return 2.0 ** round(math.log2(value))
