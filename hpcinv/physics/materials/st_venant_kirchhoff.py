"""St Venant–Kirchhoff."""

from typing import Any, ClassVar, Literal

from pydantic import field_validator

from hpcinv.base.quantity import ModulusField, StressField
from hpcinv.physics.materials.lame import LameLaw
from hpcinv.physics.materials.material_law import Deformation


class StVenantKirchhoff(LameLaw):
    """St Venant–Kirchhoff: Hooke's law between Green–Lagrange strain and second Piola–Kirchhoff stress.

    The energy is ``mu E:E + lam/2 (tr E)²``, in invariants; ``kappa = lam + 2/3 mu``. For large rotations at small
    strain: it softens under strong compression, where other laws stiffen.

    Source: Ciarlet (1988), "Mathematical Elasticity, Volume I: Three-Dimensional Elasticity", chapter 3.
    """

    formula = "mu/4*(I1**2 - 2*I1 - 2*I2 + 3)"
    example: ClassVar = {"law": "st-venant-kirchhoff", "mu": "10 kPa", "lam": "30 kPa"}

    law: Literal["st-venant-kirchhoff"] = "st-venant-kirchhoff"
    mu: ModulusField
    """Lamé's second parameter, the shear modulus"""
    lam: StressField
    """Lamé's first parameter, finite"""

    @field_validator("lam", mode="before")
    @classmethod
    def _is_finite(cls, lam: object) -> object:
        if lam == "incompressible":
            raise ValueError("must be finite; an incompressible material needs another law, with kappa")
        return lam

    @property
    def volumetric_formula(self) -> str:
        return "lam/8*(I1 - 3)**2"

    def dilatation(self, k: Deformation) -> Any:
        return k.I1_minus_3 / 2
