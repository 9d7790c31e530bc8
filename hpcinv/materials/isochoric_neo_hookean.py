"""Isochoric neo-Hookean."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal

from hpcinv.materials.isochoric import IsochoricLaw
from hpcinv.varying import ModulusField

if TYPE_CHECKING:
    from hpcinv.kinematics import Deformation


class IsochoricNeoHookean(IsochoricLaw):
    """Neo-Hookean with an isochoric-volumetric split.

    ``psi = mu/2 (I1_bar - 3) + U(J; kappa)``.

    Source: Treloar (1943), doi:10.1039/TF9433900241; the split of Flory (1961), doi:10.1039/TF9615700829.
    """

    formula = "mu/2*(I1_bar - 3)"
    example: ClassVar = {"law": "isochoric-neo-hookean", "mu": "10 kPa", "kappa": "50 kPa"}

    law: Literal["isochoric-neo-hookean"] = "isochoric-neo-hookean"
    mu: ModulusField
    """shear modulus"""

    def shear_modulus(self, par: Any) -> Any:
        return par.mu

    def distortion(self, k: Deformation, par: Any) -> Any:
        return par.mu / 2 * k.I1_bar_minus_3
