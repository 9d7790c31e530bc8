"""What the tests against closed forms share: roots by bisection, and the neo-Hookean stress by numpy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

MU, LAM = 10e3, 40e3
NEO_HOOKEAN = {"law": "neo-hookean", "mu": MU, "lam": LAM}


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """Where a function changes its sign between two points, as exactly as floating point has it."""
    rises = function(high) > 0
    assert (function(low) > 0) != rises
    while low < (middle := (low + high) / 2) < high:
        low, high = (low, middle) if (function(middle) > 0) == rises else (middle, high)
    return low


def neo_hookean_stress(F: np.ndarray, mu: float = MU, lam: float = LAM) -> np.ndarray:
    """``P = mu (F - F⁻ᵀ) + lam ln J F⁻ᵀ``."""
    inverse = np.linalg.inv(F).T
    P: np.ndarray = mu * (F - inverse) + lam * np.log(np.linalg.det(F)) * inverse
    return P


def uniaxial(stretch: float, lateral: float = 1.0) -> np.ndarray:
    """``F`` of a bar along x."""
    return np.diag([stretch, lateral, lateral])
