"""Exponents of the displacement at an edge of a body, ``u ~ r^λ``, where two flat faces meet under an angle.

With ``κ = 3 - 4ν`` of plane strain and an inner angle ω, the lowest λ solves

===================  =====================================================
both faces free      ``sin λω = λ |sin ω|``
both clamped         ``sin λω = λ |sin ω| / κ``
clamped and free     ``sin² λω = (κ + 1)² / 4κ - λ² sin² ω / κ``
===================  =====================================================

in the plane across the edge, and ``λ = π/ω``, of a clamped and a free face ``π/2ω``, along it. A face that slides is a
plane of symmetry: the angle is doubled. Energies converge with ``h^2λ`` where λ is below the degree of the elements.

Source: Williams, J. Appl. Mech. 19, 526–528 (1952), doi:10.1115/1.4010553; Rössle, J. Elasticity 60, 57–75 (2000),
doi:10.1023/A:1007639413619.
"""

import math
from collections.abc import Callable
from enum import Enum
from functools import cache

import numpy as np

SMOOTH = 1.0
"""Exponent that stands for all that does not limit elements of degree 1 to 3 much; edges above it are left out."""
_LEAST, _STEPS = 0.2, 400  # smallest exponent that is sought, and number of intervals in which its sign is looked for
_FLAT = math.radians(
    5
)  # rad: deviation from a plane that counts as none; larger: corners of up to that angle are missed


class Hold(Enum):
    """Support of a face in the plane across an edge: of both components, one of them, or none."""

    FREE = 0
    SLIDING = 1
    CLAMPED = 2


@cache
def plane_exponent(angle: float, first: Hold, second: Hold, kappa: float) -> float:
    """Return λ of displacements across an edge of an inner ``angle`` (rad); `SMOOTH` if it is not below that."""
    low, high = sorted((first, second), key=lambda hold: hold.value)
    if low is high is Hold.SLIDING:
        is_smooth = angle < math.pi / 2 + _FLAT or abs(angle - math.pi) < _FLAT
        return SMOOTH if is_smooth else min(abs(math.pi / angle - 1), SMOOTH)
    if Hold.SLIDING in (low, high):
        angle, other = min(2 * angle, 2 * math.pi), low if high is Hold.SLIDING else high
        low = high = other
    sine = abs(math.sin(angle))
    if low is high:
        if angle < math.pi + _FLAT:
            return SMOOTH
        share = 1.0 if low is Hold.FREE else 1 / kappa
        return _lowest(lambda x: math.sin(x * angle) - x * sine * share)
    return _lowest(lambda x: (kappa + 1) ** 2 / (4 * kappa) - (x * sine) ** 2 / kappa - math.sin(x * angle) ** 2)


def axial_exponent(angle: float, first: bool, second: bool) -> float:
    """Return λ of displacements along an edge, which its faces hold or not; `SMOOTH` if it is not below that."""
    is_smooth = angle < (math.pi if first is second else math.pi / 2) + _FLAT
    return SMOOTH if is_smooth else math.pi / (angle if first is second else 2 * angle)


def _lowest(function: Callable[[float], float]) -> float:
    """Return the lowest root from `_LEAST` to `SMOOTH`; of a pair of complex ones the real part, nearly."""
    exponents = np.linspace(_LEAST, SMOOTH, _STEPS + 1)
    values = np.array([function(x) for x in exponents])
    changes = np.flatnonzero(values[:-1] * values[1:] < 0)
    sizes = np.abs(values)
    least = 1 + np.flatnonzero((sizes[1:-1] < sizes[:-2]) & (sizes[1:-1] <= sizes[2:]))
    return float(exponents[min(*changes, *least, _STEPS)]) if len(changes) + len(least) else SMOOTH
