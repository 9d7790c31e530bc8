"""Rods under their weight by theory: what the finite elements of the hard cases are compared with; numpy alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

type Floats = np.ndarray


def sagging_tip(K: float, steps: int = 400) -> Floats:
    """Displacement of the tip of a straight cantilever that its weight bends, in lengths of it.

    ``θ'' = -K (1 - s) cos θ``, ``θ(0) = θ'(1) = 0``, ``K = q L³/(E I)``: inextensible and shear-rigid, by shooting from
    the tip with Runge and Kutta's method.
    """

    def slope(s: float, y: Floats) -> Floats:
        return np.array([y[1], K * (1 - s) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    def clamp(angle: float) -> Floats:
        """Angle, curvature and minus the way to the tip, at the clamp."""
        y, h = np.array([angle, 0.0, 0.0, 0.0]), -1 / steps
        for s in 1 + np.arange(steps) * h:
            a = slope(s, y)
            b = slope(s + h / 2, y + h / 2 * a)
            c = slope(s + h / 2, y + h / 2 * b)
            y = y + h / 6 * (a + 2 * b + 2 * c + slope(s + h, y + h * c))
        return y

    low, high = -np.pi / 2, 0.0
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if clamp(middle)[0] < 0 else (low, middle)
    x, y = -clamp(low)[2:]
    return np.array([x - 1, y])


def curled_axis(
    load: Callable[[Floats], tuple[Floats, Floats]],
    radius: float,
    length: float,
    c1: float,
    c2: float,
    steps: int = 800,
) -> Floats:
    """Axis (steps + 1, 2), in metres, of the round rod that its load holds straight, when it is taken away.

    Of the straight rod each fibre at height ``y`` was ``a + b y`` times as long, and carries the uniaxial stress of an
    incompressible Mooney–Rivlin material: ``∫ σ dA = 0`` and ``∫ σ y dA = M`` give ``a`` and ``b``. Undeformed, the
    axis is ``a`` times as long and turns by ``b`` per length; sections were inclined by ``V/(0.9 G A)``.

    Args:
        load: bending moment (N m) and transverse force (N) at positions along the rod (m).
    """
    # Gauss quadrature over the section: y = r sin φ, dA = 2 r² cos² φ dφ.
    points, weights = np.polynomial.legendre.leggauss(40)
    y, area = np.sin(points * np.pi / 2), weights * np.pi * np.cos(points * np.pi / 2) ** 2

    def resultants(a: float, b: float) -> Floats:
        """Force and moment by a and b r, over r² and r³."""
        stretch = 1 / (a + b * y)
        stress = 2 * (c1 + c2 / stretch) * (stretch**2 - 1 / stretch)
        return np.array([np.sum(stress * area), np.sum(stress * y * area)])

    def bent(moment: float) -> Floats:
        """``a`` and ``b r`` by Newton's method, with differences for the derivative."""
        coefficients, wanted = np.array([1.0, 0.0]), np.array([0.0, -moment / radius**3])
        for _ in range(100):
            residual = resultants(*coefficients) - wanted
            tangent = np.stack(
                [(resultants(*(coefficients + h)) - resultants(*(coefficients - h))) / 2e-6 for h in 1e-6 * np.eye(2)],
                1,
            )
            step = -np.linalg.solve(tangent, residual)
            coefficients += min(1.0, 0.5 * coefficients[0] / np.abs(step).sum()) * step
            if np.abs(step).max() < 1e-12:
                break
        return coefficients

    ds = length / steps
    positions = (np.arange(steps) + 0.5) * ds
    moments, forces = load(positions)
    ab = np.array([bent(moment) for moment in moments])
    turn = ab[:, 1] / radius * ds
    angle = np.cumsum(turn) - turn / 2 + forces / (0.9 * 2 * (c1 + c2) * np.pi * radius**2)
    ways = ab[:, :1] * ds * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(ways, axis=0)])
