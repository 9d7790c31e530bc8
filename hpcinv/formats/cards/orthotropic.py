"""Orthotropic linear elasticity: quadratic energies of Green's strains, which agree with other strains if small."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hpcinv.base.quantity.arrays import Floats
from hpcinv.formats.cards.card import CardError, Counterpart, Stress

FAMILIES = "abc"
"""names of the axes 1, 2 and 3 of the material"""


def stiffness_of(young: Sequence[float], v12: float, v13: float, v23: float) -> Floats:
    """Return the stiffness (3, 3) of normal strains by Young's moduli and Poisson's ratios ``-e_j / e_i``.

    Raises:
        CardError: there is none.
    """
    e1, e2, e3 = young
    if not all((e1, e2, e3)):
        raise CardError("an orthotropic law has a Young's modulus of 0")
    compliance = [[1 / e1, -v12 / e1, -v13 / e1], [-v12 / e1, 1 / e2, -v23 / e2], [-v13 / e1, -v23 / e2, 1 / e3]]
    try:
        inverse: Floats = np.linalg.inv(np.array(compliance))
    except np.linalg.LinAlgError:
        raise CardError("an orthotropic law has Poisson's ratios of an incompressible material") from None
    return inverse


def orthotropic(
    stiffness: Floats, shear: Sequence[float], directions: Mapping[str, Sequence[float] | None]
) -> Counterpart:
    """Return the law by the stiffness of normal strains and the shear moduli G12, G23 and G31.

    Args:
        directions: of the axes, by `FAMILIES`.

    Raises:
        CardError: its energy is not positive.
    """
    if not (np.linalg.eigvalsh(stiffness) > 0).all() or not all(modulus > 0 for modulus in shear):
        raise CardError("an orthotropic law is unstable: its stiffness is not positive")
    lam, mu = lame(stiffness, shear)
    scale = float(mu.mean())
    energy, values = f"unit/2*({quadratic(lam / scale, mu / scale)})", {"unit": Stress(scale)}
    return Counterpart({"law": "formula", "energy": energy, "parameters": values}, directions)


def lame(stiffness: Floats, shear: Sequence[float]) -> tuple[Floats, Floats]:
    """Return Lamé's parameters (3, 3) and (3,)."""
    g12, g23, g31 = shear
    mu = np.array([g12 + g31 - g23, g12 - g31 + g23, -g12 + g31 + g23])
    return stiffness - 2 * np.diag(mu), mu


def quadratic(lam: Floats, mu: Floats) -> str:
    """Return twice the energy of an orthotropic law of the strains along three families a, b, c at right angles.

    Its isotropic part is written in I1 and I2: a formula's law takes its moduli from them.
    """
    shear, stretch = float(mu.mean()), float(lam.mean())
    terms = [f"{2 * shear:.17g}*(I1**2 - 2*I2 - 2*I1 + 3)/4", f"{stretch:.17g}*((I1 - 3)/2)**2"]
    terms += [f"{2 * (m - shear):.17g}*(I5_{f} - 2*I4_{f} + 1)/4" for m, f in zip(mu, FAMILIES, strict=True)]
    strain = [f"(I4_{name} - 1)/2" for name in FAMILIES]
    terms += [f"{lam[i, j] - stretch:.17g}*{strain[i]}*{strain[j]}" for i in range(3) for j in range(3)]
    return " + ".join(terms)
