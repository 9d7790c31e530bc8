"""Follower pressure."""

from typing import Any, ClassVar, Literal

from hpcinv.base.quantity import StressField, Surface
from hpcinv.physics.effects.effect import Effect, Kinematics


class Pressure(Effect):
    """Follower pressure, normal to the deformed surface: ``-∫ p n·v da``, with the current normal and area.

    Source: Bonet & Wood (2008), §8.5, doi:10.1017/CBO9780511755446.
    """

    example: ClassVar = {"effect": "pressure", "region": "x1", "pressure": "12 mmHg"}

    effect: Literal["pressure"] = "pressure"
    region: Surface
    """region of the boundary"""
    pressure: StressField
    """pressure against the outward normal of the current body; negative is suction"""

    def virtual_work(self, k: Kinematics, v: Any, load: Any, par: Any) -> Any:
        return k.n_da(-load * par.pressure * v, self.region)
