"""Yeoh."""

from typing import Any, ClassVar, Literal

from hpcinv.base.quantity import ModulusField, StressField
from hpcinv.physics.materials.isochoric import IsochoricLaw
from hpcinv.physics.materials.material_law import StartingValues


class Yeoh(IsochoricLaw):
    """Yeoh, a cubic polynomial for rubber that stiffens at large strain.

    ``mu = 2 c1``.

    Source: Yeoh (1993), doi:10.5254/1.3538343.
    """

    formula = "c1*(I1_bar - 3) + c2*(I1_bar - 3)**2 + c3*(I1_bar - 3)**3"
    replaceable = ("c1", "kappa")
    example: ClassVar = {"law": "yeoh", "c1": "0.2 MPa", "c2": "-4 kPa", "c3": "0.5 kPa", "kappa": "2 MPa"}
    starting_values: ClassVar = {
        "rubber": StartingValues(
            {"c1": "0.176 MPa", "c2": "-1.8 kPa", "c3": "45.6 Pa", "kappa": "incompressible"},
            "natural rubber",
            "our fit to the uniaxial test of Treloar (1944), doi:10.1039/TF9444000059, up to a stretch of 7.6",
        ),
    }

    law: Literal["yeoh"] = "yeoh"
    c1: ModulusField
    """coefficient of I1_bar - 3, half the shear modulus"""
    c2: StressField
    """coefficient of (I1_bar - 3)², negative for most rubbers"""
    c3: StressField
    """coefficient of (I1_bar - 3)³"""

    def shear_modulus(self, par: Any) -> Any:
        return 2 * par.c1
