"""Contraction of FeenoX's stretched cell with 40 digits: ``python benchmarks/published/feenox/one_unknown.py``.

By symmetry all nodes of the pulled face move by the same distance towards the axis, so the cell has one unknown. Its
energy is integrated at 2 x 2 x 2 points, and Newton's method begins with the solution of linear elasticity.
"""

from itertools import product
from typing import Any

import mpmath as mp

mp.mp.dps = 40
PULL, LAM, MU = mp.mpf("0.25"), mp.mpf("0.4"), mp.mpf("0.4")
STEP = mp.mpf(10) ** -10
POINTS = [[(1 + sign / mp.sqrt(3)) / 2 for sign in signs] for signs in product((-1, 1), repeat=3)]
REFLEX = {"svk": "-0.049812041887", "neo-hookean": "-0.041081556232", "hencky": "-0.03850440789"}


def density(law: str, F: Any) -> Any:
    """Return the energy per reference volume (Pa)."""
    C, J = F.T * F, mp.det(F)
    trace = C[0, 0] + C[1, 1] + C[2, 2]
    if law == "svk":
        E = (C - mp.eye(3)) / 2
        return LAM / 2 * ((trace - 3) / 2) ** 2 + MU * sum(E[i, j] ** 2 for i in range(3) for j in range(3))
    if law == "neo-hookean":
        return MU / 2 * (J ** (-mp.mpf(2) / 3) * trace - 3) + (LAM + 2 * MU / 3) / 2 * (J - 1) ** 2
    strains = [mp.log(square) / 2 for square in mp.eigsy(C, eigvals_only=True)]
    return LAM / 2 * sum(strains) ** 2 + MU * sum(strain**2 for strain in strains)


def energy(law: str, v: Any, pull: Any) -> Any:
    """Return the energy (J) at a contraction ``v`` (m), negative towards the axis."""
    gradients = (
        mp.matrix([[1 + pull, 0, 0], [(2 * y - 1) * v, 1 + 2 * x * v, 0], [(2 * z - 1) * v, 0, 1 + 2 * x * v]])
        for x, y, z in POINTS
    )
    return sum(density(law, F) for F in gradients) / len(POINTS)


def contraction(law: str) -> Any:
    """Return the contraction (m) in equilibrium."""
    v = -mp.mpf("0.044117647058823529")  # linear elasticity: -3/68
    for _ in range(6):
        low, middle, high = (energy(law, v + k * STEP, PULL) for k in (-1, 0, 1))
        v -= (high - low) / 2 * STEP / (high - 2 * middle + low)
    return v


if __name__ == "__main__":
    for law, theirs in REFLEX.items():
        print(f"{law}: {mp.nstr(contraction(law), 14)}, Reflex {theirs}")
