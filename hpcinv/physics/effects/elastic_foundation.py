"""Elastic foundation."""

from typing import Any, ClassVar, Literal

from pydantic import ValidationInfo

from hpcinv.base.quantity import Faults, StiffnessField, Surface
from hpcinv.physics.effects.effect import Configuration, Effect, Kinematics


class ElasticFoundation(Effect):
    """Springs between a surface and the ground, unstretched in the undeformed body.

    Their traction is ``t = -k_n (u·m) m - k_t (u - (u·m) m)`` per area, where ``m`` is the normal of the body in the
    configuration that ``area_in`` names: ``∫ t·v dA`` with the reference normal, or ``∫ t·v da`` with the current one.
    With ``normal`` alone the surface can slide; equal ``normal`` and ``tangential`` are springs in all directions.
    Springs have their full stiffness at every load factor.

    Source: Pfaller et al. (2019), doi:10.1007/s10237-018-1098-4.
    """

    example: ClassVar = {
        "effect": "elastic-foundation",
        "region": "x1",
        "normal": "5 kPa/m",
        "tangential": "1 kPa/m",
    }

    effect: Literal["elastic-foundation"] = "elastic-foundation"
    region: Surface
    """region of the boundary"""
    normal: StiffnessField | None = None
    """stiffness per area against motion along the normal"""
    tangential: StiffnessField | None = None
    """stiffness per area against motion in the surface"""
    area_in: Configuration = "reference"
    """configuration whose area and normal the springs have"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if self.normal is None and self.tangential is None:
            yield (), "needs a stiffness: normal, tangential or both"
        if self.case is not None:
            yield ("case",), "is not valid here: springs act in every load case"

    @property
    def holds(self) -> frozenset[str]:
        return frozenset("xyz")

    def virtual_work(self, k: Kinematics, v: Any, load: Any, par: Any) -> Any:
        m = k.N if self.area_in == "reference" else k.n
        u_m, v_m = (sum(w[i] * m[i] for i in range(3)) for w in (k.u, v))
        u_v = sum(k.u[i] * v[i] for i in range(3))
        work = 0
        if self.normal is not None:
            work = work - par.normal * u_m * v_m
        if self.tangential is not None:
            work = work - par.tangential * (u_v - u_m * v_m)
        return k.dA(work, self.region) if self.area_in == "reference" else k.da(work, self.region)
