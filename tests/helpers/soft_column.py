"""A soft body, and a column of it under its weight that is held laterally: closed forms by quadrature."""

from __future__ import annotations

from math import log
from typing import Any

from scipy.integrate import quad

from helpers.closed_forms import root
from helpers.command_line import NO_CERTIFICATE

MU, LAM = 1e4, 4e4
SOFT: dict[str, Any] = {"material": {"law": "neo-hookean", "mu": MU, "lam": LAM}, "certificate": NO_CERTIFICATE}


def gravity(up: float, **changes: Any) -> dict[str, Any]:
    return {"effect": "gravity", "acceleration": [0, 0, up * 9.81], "density": 200} | changes


def confined(stretch: float) -> float:
    """Stress (Pa) of a body that is stretched without lateral motion, nominal and true."""
    return (MU * (stretch**2 - 1) + LAM * log(stretch)) / stretch


def column_stretch(z: float, up: float) -> float:
    """Stretch of a confined column at height z under a weight that acts upwards ``up``-fold."""
    return root(lambda s: confined(s) - up * 9810 * (1 - z), 0.5, 2.0)


def column_length(up: float) -> float:
    """Length (m) of the same column, which is 1 m long where it stands."""
    return float(quad(lambda z: column_stretch(z, up) / column_stretch(z, -1), 0, 1, epsabs=1e-11)[0])
