"""Fung–Demiray."""

from typing import ClassVar, Literal

from hpcinv.base.quantity import ModulusField, PositiveField
from hpcinv.physics.materials.isochoric import IsochoricLaw
from hpcinv.physics.materials.material_law import StartingValues


class FungDemiray(IsochoricLaw):
    """Fung–Demiray, the isotropic exponential law of soft tissue.

    Source: Demiray (1972), doi:10.1016/0021-9290(72)90047-4.
    """

    formula = "mu/(2*b)*(exp(b*(I1_bar - 3)) - 1)"
    replaceable = ("mu", "kappa")
    example: ClassVar = {"law": "fung-demiray", "mu": "5 kPa", "b": 4, "kappa": "40 kPa"}
    starting_values: ClassVar = {
        "tissue": StartingValues(
            {"mu": "44.2 kPa", "b": 8.35, "kappa": "incompressible"},
            "human carotid artery",
            "Delfino et al. (1997), doi:10.1016/S0021-9290(97)00025-0: a = 44.2 kPa, b = 16.7",
        ),
    }

    law: Literal["fung-demiray"] = "fung-demiray"
    mu: ModulusField
    """shear modulus of the undeformed material"""
    b: PositiveField
    """exponent, how fast the material stiffens"""
