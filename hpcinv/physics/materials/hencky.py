"""Hencky."""

from typing import Any, ClassVar, Literal

from hpcinv.base.quantity import ModulusField
from hpcinv.physics.materials.isochoric import IsochoricLaw, Volumetric
from hpcinv.physics.materials.material_law import Deformation


class Hencky(IsochoricLaw):
    """Hencky, with the logarithmic strain of the principal stretches; for metals and plastics at moderate strain.

    With the logarithmic energy of the volume, the default, the Kirchhoff stress is linear in the logarithmic strain. In
    tension the force grows up to a stretch of e, if the material is incompressible.

    Source: Hencky (1928), "Über die Form des Elastizitätsgesetzes bei ideal elastischen Stoffen", Zeitschrift für
    technische Physik 9, 215-220; Anand (1979), doi:10.1115/1.3424532.
    """

    formula = "mu*(ln(lambda1_bar)**2 + ln(lambda2_bar)**2 + ln(lambda3_bar)**2)"
    replaceable = ("mu", "kappa")
    example: ClassVar = {"law": "hencky", "mu": "10 kPa", "kappa": "50 kPa"}

    law: Literal["hencky"] = "hencky"
    mu: ModulusField
    """shear modulus"""
    volumetric: Volumetric = "logarithmic"
    """volumetric energy U"""

    # Principal stretches are not among the invariants of formulas, as in Ogden's law.
    def isochoric_energy(self, k: Deformation, par: Any) -> Any:
        from hpcinv.physics.kinematics.principal_stretches import IsochoricStretches

        return par.mu * IsochoricStretches(k).log_square_sum
