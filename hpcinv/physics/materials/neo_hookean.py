"""Compressible neo-Hookean."""

from dataclasses import replace
from typing import Any, ClassVar, Literal

from hpcinv.base.quantity import LameField, StressField
from hpcinv.physics.materials.isochoric import DILATATIONS
from hpcinv.physics.materials.isochoric_neo_hookean import IsochoricNeoHookean
from hpcinv.physics.materials.lame import LameLaw
from hpcinv.physics.materials.material_law import Deformation


class NeoHookean(LameLaw):
    """Compressible neo-Hookean.

    ``kappa = lam + 2/3 mu``.

    Source: Mazier et al. (2022), eq. 22, doi:10.1007/s00366-021-01597-z.
    """

    formula = "mu/2*(I1 - 3) - mu*ln(J)"
    example: ClassVar = {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"}
    starting_values: ClassVar = {
        **IsochoricNeoHookean.starting_values,
        "rubber": replace(
            IsochoricNeoHookean.starting_values["rubber"], parameters={"mu": "0.34 MPa", "lam": "incompressible"}
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
