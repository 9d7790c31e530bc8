"""What the laws with a split of the energy into an isochoric and a volumetric part have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hpcinv.materials.base import MaterialLaw
from hpcinv.materials.volumetric import DILATATIONS, Volumetric
from hpcinv.quantity.spatial_fields import BulkModulusField

if TYPE_CHECKING:
    from hpcinv.kinematics.kinematics import Deformation


class IsochoricLaw(MaterialLaw):
    """A law of the form ``psi = formula + U(J; kappa)``."""

    kappa: BulkModulusField
    """bulk modulus, or 'incompressible'"""
    volumetric: Volumetric = "quadratic"
    """volumetric energy U"""

    @property
    def volumetric_formula(self) -> str:
        return DILATATIONS[self.volumetric][0]

    def bulk_modulus(self, par: Any) -> Any:
        return par.kappa

    def dilatation_modulus(self, par: Any) -> Any:
        return par.kappa

    def dilatation(self, k: Deformation) -> Any:
        return DILATATIONS[self.volumetric][1](k)
