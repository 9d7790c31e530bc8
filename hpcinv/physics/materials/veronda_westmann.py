"""Veronda–Westmann."""

from typing import Any, ClassVar, Literal

from hpcinv.base.quantity import ModulusField, PositiveField
from hpcinv.physics.materials.isochoric import IsochoricLaw


class VerondaWestmann(IsochoricLaw):
    """Veronda–Westmann, for skin, with isochoric invariants.

    ``mu = c1 c2``.

    Source: Veronda & Westmann (1970), "Mechanical characterization of skin – finite deformations", Journal of
    Biomechanics 3.
    """

    formula = "c1*(exp(c2*(I1_bar - 3)) - 1) - c1*c2/2*(I2_bar - 3)"
    replaceable = ("c1", "kappa")
    example: ClassVar = {"law": "veronda-westmann", "c1": "2 kPa", "c2": 3, "kappa": "40 kPa"}

    law: Literal["veronda-westmann"] = "veronda-westmann"
    c1: ModulusField
    """stress that scales the energy; the shear modulus of the undeformed material is c1 c2"""
    c2: PositiveField
    """exponent, how fast the material stiffens"""

    def shear_modulus(self, par: Any) -> Any:
        return par.c1 * par.c2
