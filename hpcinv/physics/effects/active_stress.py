"""Active stress."""

from typing import Any, ClassVar, Literal

from hpcinv.base.quantity import Family, StressField
from hpcinv.physics.effects.effect import Deformation, Effect


class ActiveStress(Effect):
    """Contraction of muscle, a second Piola–Kirchhoff stress ``S = T a0⊗a0`` along fibres, ``P = T F a0⊗a0``.

    ``T`` is a force per reference area, divided by the stretch of the fibre. It derives from the potential
    ``T/2 (I4 - 1)``, which is not part of the stored energy.

    Source: Land et al. (2015), doi:10.1098/rspa.2015.0641.
    """

    example: ClassVar = {"effect": "active-stress", "fibre": "fibre", "stress": "2 kPa"}

    effect: Literal["active-stress"] = "active-stress"
    fibre: Family = "fibre"
    """family of fibres along which it acts"""
    stress: StressField
    """active stress T; positive contracts"""

    def potential(self, k: Deformation, load: Any, par: Any) -> Any:
        return load * par.stress / 2 * k.fibre(self.fibre).I4_minus_1
