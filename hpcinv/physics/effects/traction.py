"""Traction."""

from typing import Any, ClassVar, Literal

from hpcinv.base.quantity import StressField, Surface, Triple
from hpcinv.physics.effects.effect import Configuration, Effect, Kinematics


class Traction(Effect):
    """Force per area of a surface, with a fixed direction in space.

    ``area_in: reference`` is a dead traction, ``∫ t·v dA``, whose force on a piece of material does not depend on the
    deformation. ``area_in: current`` is a spatial traction, ``∫ t·v da``, given per deformed area.

    Source: Bonet & Wood (2008), ch. 6, doi:10.1017/CBO9780511755446.
    """

    example: ClassVar = {
        "effect": "traction",
        "region": "x1",
        "traction": ["1 kPa", 0, "-0.5 kPa"],
        "area_in": "reference",
    }

    effect: Literal["traction"] = "traction"
    region: Surface
    """region of the boundary"""
    traction: Triple[StressField]
    """force per area, along x, y and z"""
    area_in: Configuration
    """configuration whose area the traction refers to: reference (dead) or current (spatial)"""

    def virtual_work(self, k: Kinematics, v: Any, load: Any, par: Any) -> Any:
        work = load * sum(t * v[i] for i, t in enumerate(par.traction))
        return k.dA(work, self.region) if self.area_in == "reference" else k.da(work, self.region)
