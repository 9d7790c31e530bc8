"""Isochoric neo-Hookean."""

from typing import ClassVar, Literal

from hpcinv.base.quantity import ModulusField
from hpcinv.physics.materials.isochoric import IsochoricLaw
from hpcinv.physics.materials.material_law import StartingValues


class IsochoricNeoHookean(IsochoricLaw):
    """Neo-Hookean with an isochoric-volumetric split.

    Source: Treloar (1943), doi:10.1039/TF9433900241; the split of Flory (1961), doi:10.1039/TF9615700829.
    """

    formula = "mu/2*(I1_bar - 3)"
    replaceable = ("mu", "kappa")
    example: ClassVar = {"law": "isochoric-neo-hookean", "mu": "10 kPa", "kappa": "50 kPa"}
    starting_values: ClassVar = {
        "rubber": StartingValues(
            {"mu": "0.34 MPa", "kappa": "incompressible"},
            "natural rubber",
            "our fit to the uniaxial test of Treloar (1944), doi:10.1039/TF9444000059, up to a stretch of 3",
        ),
        "tissue": StartingValues(
            {"young": "3.25 kPa", "poisson": 0.5},
            "fat of the breast",
            "Samani, Zubovits & Plewes (2007), doi:10.1088/0031-9155/52/6/002, at small strain",
        ),
    }

    law: Literal["isochoric-neo-hookean"] = "isochoric-neo-hookean"
    mu: ModulusField
    """shear modulus"""
