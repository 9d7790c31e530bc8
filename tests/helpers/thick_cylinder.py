"""Closed form of a thick incompressible neo-Hookean tube in plane strain with a pressure inside.

``b² - B² = a² - A²``, and with ``λ = r/R`` the pressure is ``μ (ln(λ_a/λ_b) + ½ (1/λ_b² - 1/λ_a²))``.
"""

from math import log

from helpers.closed_forms import root

INNER, OUTER, PRESSURE = 1.0, 1.5, 0.2  # of the loaded tube, m and Pa; the shear modulus is 1 Pa


def outer_radius(A: float) -> float:
    """The outer radius that belongs to an inner one, at rest."""
    return float((OUTER**2 - INNER**2 + A**2) ** 0.5)


def carried(A: float) -> float:
    """Pressure that takes the inner radius from ``A`` to `INNER`."""
    a, b = INNER / A, OUTER / outer_radius(A)
    return log(a / b) + (b**-2 - a**-2) / 2


A = root(lambda A: carried(A) - PRESSURE, 0.5, 1.0)
B = outer_radius(A)
