"""Pressure that varies smoothly over a surface, of few numbers."""

from typing import Any, ClassVar, Literal

from pydantic import ValidationInfo

from hpcinv.base.quantity import Faults, Length, ListOf, Size, Stress, Surface, Triple
from hpcinv.physics.effects.bells import bells
from hpcinv.physics.effects.effect import Effect, Kinematics


class SmoothPressure(Effect):
    """Pressure of bells around points in space: ``-∫ p n·v da`` with ``p = Σ pᵢ exp(-|x - cᵢ|²/(2 w²))``.

    The position x is the current one. Neighbouring organs press so; `identify` finds their pressures.
    """

    example: ClassVar = {
        "effect": "smooth-pressure",
        "region": "x1",
        "centres": [[1, "20 cm", "30 cm"], [1, "80 cm", "60 cm"]],
        "width": "40 cm",
        "pressures": ["1 kPa", "-0.5 kPa"],
    }

    effect: Literal["smooth-pressure"] = "smooth-pressure"
    region: Surface
    """region of the boundary"""
    centres: ListOf[Triple[Length]]
    """points in space, on or near the surface, about a width apart"""
    width: Size
    """standard deviation w of each bell"""
    pressures: ListOf[Stress]
    """pressure of each bell in its middle, against the outward normal"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if len(self.pressures) != len(self.centres):
            yield ("pressures",), f"has {len(self.pressures)} numbers for {len(self.centres)} centres"
        elif not self.centres:
            yield ("centres",), "has no point"

    def structure(self) -> Any:
        return len(self.centres)

    def virtual_work(self, k: Kinematics, v: Any, load: Any, par: Any) -> Any:
        fields = bells(k.x, par.centres, par.width, len(self.centres))
        pressure = sum(par.pressures[number] * field for number, field in enumerate(fields))
        return k.n_da(-load * pressure * v, self.region)
