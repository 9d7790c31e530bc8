"""Growth and shrinkage."""

from typing import Any, ClassVar, Literal

from pydantic import ValidationInfo

from hpcinv.base.quantity import Family, Faults, PositiveField
from hpcinv.physics.effects.effect import Deformation, Effect


class Growth(Effect):
    """Stress-free stretch of the reference body, isotropic or different along fibres.

    ``F_g = across I + (along - across) a0⊗a0``, or ``F_g = stretch I``; ``F = F_e F_g``, and the stresses follow from
    ``J_g psi(F_e)``. The given stretches hold at full load; they change linearly from 1 with the load factor.

    Source: Rodriguez, Hoger & McCulloch (1994), doi:10.1016/0021-9290(94)90021-3.
    """

    example: ClassVar = {"effect": "growth", "stretch": 1.1}

    effect: Literal["growth"] = "growth"
    stretch: PositiveField | None = None
    """stretch in all directions"""
    fibre: Family | None = None
    """family of fibres with a different stretch along them"""
    along: PositiveField | None = None
    """stretch along the fibres"""
    across: PositiveField | None = None
    """stretch across the fibres"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        wanted = {"stretch"} if self.fibre is None else {"along", "across"}
        form = "without fibres" if self.fibre is None else "along fibres"
        for key in ("stretch", "along", "across"):
            if (getattr(self, key) is not None) != (key in wanted):
                yield (key,), f"{'is needed' if key in wanted else 'is not valid'} in growth {form}"

    def inelastic_strain(self, k: Deformation, load: Any, par: Any) -> Any:
        if self.fibre is None:
            return load * (par.stretch - 1) * k.I
        return load * ((par.across - 1) * k.I + (par.along - par.across) * k.fibre(self.fibre).dyad)
