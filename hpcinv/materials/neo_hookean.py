"""Compressible neo-Hookean."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal

from hpcinv.materials.base import StartingValues
from hpcinv.materials.isochoric import DILATATIONS
from hpcinv.materials.lame import LameLaw
from hpcinv.quantity.spatial_fields import LameField, StressField

if TYPE_CHECKING:
    from hpcinv.kinematics.kinematics import Deformation


class NeoHookean(LameLaw):
    """Compressible neo-Hookean.

    ``kappa = lam + 2/3 mu``.

    Source: Mazier et al. (2022), eq. 22, doi:10.1007/s00366-021-01597-z.
    """

    formula = "mu/2*(I1 - 3) - mu*ln(J)"
    example: ClassVar = {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"}
    starting_values: ClassVar = {
        "rubber": StartingValues(
            {"mu": "0.34 MPa", "lam": "incompressible"},
            "natural rubber",
            "our fit to the uniaxial test of Treloar (1944), doi:10.1039/TF9444000059, up to a stretch of 3",
        ),
        "tissue": StartingValues(
            {"young": "3.25 kPa", "poisson": 0.5},
            "fat of the breast",
            "Samani, Zubovits & Plewes (2007), doi:10.1088/0031-9155/52/6/002, at small strain",
        ),
    }

    law: Literal["neo-hookean"] = "neo-hookean"
    mu: StressField
    """Lamé's second parameter, the shear modulus"""
    lam: LameField
    """Lamé's first parameter, or 'incompressible'"""

    @property
    def volumetric_formula(self) -> str:
        return DILATATIONS["logarithmic"][0].replace("kappa", "lam")

    def dilatation(self, k: Deformation) -> Any:
        return DILATATIONS["logarithmic"][1](k)
