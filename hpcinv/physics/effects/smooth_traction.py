"""Traction that varies smoothly over a surface, of few numbers."""

from typing import Any, ClassVar, Literal

from pydantic import ValidationInfo

from hpcinv.base.quantity import Faults, Length, ListOf, Size, Stress, Surface, Triple
from hpcinv.physics.effects.bells import bells
from hpcinv.physics.effects.effect import Effect, Kinematics


class SmoothTraction(Effect):
    """Traction of bells around points in space: ``∫ t·v da`` with ``t = Σ tᵢ exp(-|x - cᵢ|²/(2 w²))``.

    The position x is the current one. Neighbouring organs pull and rub so; `identify` finds their tractions.
    """

    example: ClassVar = {
        "effect": "smooth-traction",
        "region": "x1",
        "centres": [[1, "20 cm", "30 cm"], [1, "80 cm", "60 cm"]],
        "width": "40 cm",
        "tractions": [["1 kPa", 0, "-0.5 kPa"], [0, "0.7 kPa", 0]],
    }

    effect: Literal["smooth-traction"] = "smooth-traction"
    region: Surface
    """region of the boundary"""
    centres: ListOf[Triple[Length]]
    """points in space, on or near the surface, about a width apart"""
    width: Size
    """standard deviation w of each bell"""
    tractions: ListOf[Triple[Stress]]
    """force per current area of each bell in its middle, along x, y and z"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if len(self.tractions) != len(self.centres):
            yield ("tractions",), f"has {len(self.tractions)} vectors for {len(self.centres)} centres"
        elif not self.centres:
            yield ("centres",), "has no point"

    def structure(self) -> Any:
        return len(self.centres)

    def virtual_work(self, k: Kinematics, v: Any, load: Any, par: Any) -> Any:
        fields = bells(k.x, par.centres, par.width, len(self.centres))
        work = sum(
            field * sum(par.tractions[number, i] * v[i] for i in range(3)) for number, field in enumerate(fields)
        )
        return k.da(load * work, self.region)
