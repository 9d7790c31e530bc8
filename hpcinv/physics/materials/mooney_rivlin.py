"""Mooney–Rivlin."""

from typing import Any, ClassVar, Literal

from hpcinv.base.quantity import BulkModulusField, StressField
from hpcinv.physics.materials.isochoric import DILATATIONS, Volumetric
from hpcinv.physics.materials.material_law import Deformation, MaterialLaw, StartingValues


class MooneyRivlin(MaterialLaw):
    """Mooney–Rivlin with isochoric invariants.

    ``mu = 2 (c1 + c2)``, ``kappa = 2 d1``.

    Source: Mazier et al. (2022), eq. 23, doi:10.1007/s00366-021-01597-z.
    """

    formula = "c1*(I1_bar - 3) + c2*(I2_bar - 3)"
    replaceable = ("c1", "d1")
    example: ClassVar = {"law": "mooney-rivlin", "c1": "0.1 MPa", "c2": "0.15 MPa", "d1": "1 MPa"}
    starting_values: ClassVar = {
        "rubber": StartingValues(
            {"c1": "0.113 MPa", "c2": "0.096 MPa", "d1": "incompressible"},
            "natural rubber",
            "our fit to the uniaxial test of Treloar (1944), doi:10.1039/TF9444000059, up to a stretch of 4",
        ),
    }

    law: Literal["mooney-rivlin"] = "mooney-rivlin"
    c1: StressField
    """coefficient of I1_bar - 3"""
    c2: StressField
    """coefficient of I2_bar - 3"""
    d1: BulkModulusField
    """half the bulk modulus, the coefficient of (J - 1)² (Abaqus's D1 is 1/d1), or 'incompressible'"""
    volumetric: Volumetric = "quadratic"
    """volumetric energy U"""

    @property
    def volumetric_formula(self) -> str:
        return DILATATIONS[self.volumetric][0].replace("kappa", "(2*d1)")

    def shear_modulus(self, par: Any) -> Any:
        return 2 * (par.c1 + par.c2)

    def bulk_modulus(self, par: Any) -> Any:
        return 2 * par.d1

    def dilatation(self, k: Deformation) -> Any:
        return DILATATIONS[self.volumetric][1](k)
