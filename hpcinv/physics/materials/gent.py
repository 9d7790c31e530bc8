"""Gent."""

from typing import ClassVar, Literal

from hpcinv.base.quantity import ModulusField, PositiveField
from hpcinv.physics.materials.isochoric import IsochoricLaw
from hpcinv.physics.materials.material_law import StartingValues


class Gent(IsochoricLaw):
    """Gent, for rubber of limited extensibility.

    Defined for ``I1_bar - 3 < jm``.

    Source: Gent (1996), doi:10.5254/1.3538357.
    """

    formula = "-mu*jm/2*ln(1 - (I1_bar - 3)/jm)"
    replaceable = ("mu", "kappa")
    example: ClassVar = {"law": "gent", "mu": "0.3 MPa", "jm": 30, "kappa": "2 MPa"}
    starting_values: ClassVar = {
        "rubber": StartingValues(
            {"mu": "0.3 MPa", "jm": 93.9, "kappa": "incompressible"},
            "natural rubber",
            "our fit to the uniaxial test of Treloar (1944), doi:10.1039/TF9444000059, up to a stretch of 7.6",
        ),
    }

    law: Literal["gent"] = "gent"
    mu: ModulusField
    """shear modulus"""
    jm: PositiveField
    """value of I1_bar - 3 at which the material cannot be stretched further"""
