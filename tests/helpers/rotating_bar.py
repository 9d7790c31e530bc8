"""A bar that rotates about an axis at its end: length at rest and lengthening by Runge and Kutta's method."""

from math import log

import numpy as np
import pytest

from helpers.closed_forms import LAM, MU, neo_hookean_stress, root, uniaxial

LENGTH, SPIN, DENSITY = 1.0, 5.0, 1000.0  # m, rad/s, kg/m³


def stress(stretch: float) -> float:
    return float(neo_hookean_stress(uniaxial(stretch))[0, 0])


def stiffness(stretch: float) -> float:
    """``dP/dλ``."""
    return MU * (1 + stretch**-2) + LAM * (1 - log(stretch)) / stretch**2


def energy(stretch: float) -> float:
    return MU / 2 * (stretch**2 - 1 - 2 * log(stretch)) + LAM / 2 * log(stretch) ** 2


def rest_length(rotating: float, density_in: str, steps: int = 500) -> float:
    """Length at rest of the bar that is ``rotating`` m long."""

    def slope(x: float, y: np.ndarray) -> np.ndarray:
        """Of ``X`` and ``λ`` along ``x``."""
        _, stretch = y
        density = DENSITY * SPIN**2 * x / (stretch if density_in == "reference" else 1)
        return np.array([1 / stretch, -density / stiffness(stretch)])

    def first_integral(x: float, stretch: float) -> float:
        part = stretch * stress(stretch) - energy(stretch) if density_in == "reference" else stress(stretch)
        return part + DENSITY * SPIN**2 * x**2 / 2

    h, y = -rotating / steps, np.array([0.0, 1.0])
    for x in rotating + h * np.arange(steps):
        a = slope(x, y)
        b = slope(x + h / 2, y + h / 2 * a)
        c = slope(x + h / 2, y + h / 2 * b)
        y = y + h / 6 * (a + 2 * b + 2 * c + slope(x + h, y + h * c))
    assert first_integral(0.0, y[1]) == pytest.approx(first_integral(rotating, 1.0), rel=1e-12)
    return -float(y[0])


def lengthening(direction: str, density_in: str) -> float:
    """Of the bar that is 1 m long at rest (forward) or as it rotates (inverse), from the differential equation."""
    if direction == "inverse":
        return LENGTH - rest_length(LENGTH, density_in)
    return root(lambda length: rest_length(length, density_in) - LENGTH, LENGTH, 1.4 * LENGTH) - LENGTH
