"""Mooney–Rivlin."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from hpcinv.materials.base import MaterialLaw
from hpcinv.quantities import BulkStress, Stress

if TYPE_CHECKING:
    from hpcinv.kinematics import Deformation


class MooneyRivlin(MaterialLaw):
    """Mooney–Rivlin with isochoric invariants and a quadratic volumetric energy.

    ``psi = c1 (I1_bar - 3) + c2 (I2_bar - 3) + d1 (J - 1)²``; ``mu = 2 (c1 + c2)``, ``kappa = 2 d1``.

    Source: Mazier et al. (2022), eq. 23, doi:10.1007/s00366-021-01597-z.
    """

    law: Literal["mooney-rivlin"] = "mooney-rivlin"
    c1: Stress
    """coefficient of I1_bar - 3"""
    c2: Stress
    """coefficient of I2_bar - 3"""
    d1: BulkStress
    """coefficient of (J - 1)², half the bulk modulus, or 'incompressible'"""

    @property
    def shear_modulus(self) -> float:
        return 2 * (self.c1 + self.c2)

    @property
    def bulk_modulus(self) -> float:
        return 2 * self.d1

    @property
    def dilatation_modulus(self) -> float:
        return 2 * self.d1

    def distortion(self, k: Deformation, par: Any) -> Any:
        return par.c1 * k.I1_bar_minus_3 + par.c2 * k.I2_bar_minus_3

    def dilatation(self, k: Deformation) -> Any:
        return k.J_minus_1
