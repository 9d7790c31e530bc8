"""Pressure of a fluid column."""

from typing import Any, ClassVar, Literal

from pydantic import ValidationInfo

from hpcinv.base.quantity import Acceleration, Density, Faults, Length, Surface, Triple
from hpcinv.physics.effects.effect import Effect, Kinematics
from hpcinv.physics.kinematics.stable_functions import positive_part

_DEGREE = 30
"""Quadrature degree, since the pressure has a kink at the level: the error of the force falls with its square, and the
time of the surface integral grows with it (175 points on a triangle)."""


class HydrostaticPressure(Effect):
    """Pressure of a static fluid that covers or fills the deformed surface up to a given level.

    ``p = rho g·(x - x0)`` below the free surface through ``x0``, where ``x`` is the current position, and zero above
    it; it acts on the current surface, ``-∫ p n·v da``. The load factor scales the pressure, not the level.
    """

    example: ClassVar = {
        "effect": "hydrostatic-pressure",
        "region": "x1",
        "density": "1 g/cm^3",
        "acceleration": [0, 0, -9.81],
        "level": [0, 0, "0.8 m"],
    }

    effect: Literal["hydrostatic-pressure"] = "hydrostatic-pressure"
    region: Surface
    """region of the boundary"""
    density: Density
    """mass density of the fluid"""
    acceleration: Triple[Acceleration]
    """acceleration of free fall, along x, y and z"""
    level: Triple[Length]
    """a point on the free surface of the fluid"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if not any(self.acceleration):
            yield ("acceleration",), "must not be zero: without gravity there is no hydrostatic pressure"

    def virtual_work(self, k: Kinematics, v: Any, load: Any, par: Any) -> Any:
        head = sum(g * (k.x[i] - par.level[i]) for i, g in enumerate(par.acceleration))
        return k.n_da(-load * par.density * positive_part(head) * v, self.region, _DEGREE)
