"""Thermal expansion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal

from hpcinv.effects.base import Effect
from hpcinv.varying import ExpansionField, TemperatureField

if TYPE_CHECKING:
    from hpcinv.kinematics import Deformation


class ThermalExpansion(Effect):
    """A stress-free stretch ``F_g = (1 + alpha ΔT) I`` of the reference body; ``F = F_e F_g``.

    The stresses follow from the elastic part ``F_e``, with the energy ``J_g psi(F_e)`` per reference volume. The load
    factor scales the temperature change.

    Source: Vujošević & Lubarda (2002), Theoretical and Applied Mechanics 28–29.
    """

    example: ClassVar = {"effect": "thermal-expansion", "coefficient": "3e-4 1/K", "temperature_change": "40 K"}

    effect: Literal["thermal-expansion"] = "thermal-expansion"
    coefficient: ExpansionField
    """coefficient of linear expansion, alpha"""
    temperature_change: TemperatureField
    """temperature of the deformed body less that of the undeformed one, ΔT"""

    def inelastic_strain(self, k: Deformation, load: Any, par: Any) -> Any:
        return load * par.coefficient * par.temperature_change * k.I
