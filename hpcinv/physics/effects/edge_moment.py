"""Moment on an edge of a shell."""

from typing import Any, ClassVar, Literal

from hpcinv.base.quantity import MomentField, Surface, Triple
from hpcinv.physics.effects.effect import Effect, Kinematics


class EdgeMoment(Effect):
    """Moment per length of an edge of a shell, with a fixed direction in space: ``∫ m·δω dL``.

    Material lines ``d`` through the thickness have the virtual rotation ``δω = d × δd / d·d``. Its mean over the
    thickness is taken. A moment about the lines does no work. It has no resultant force, unlike a pressure that is
    linear through the thickness, whose area and normals change with the edge.

    Source: Büchter & Ramm, Int. J. Numer. Meth. Engng 34, 39-59, 1992, doi:10.1002/nme.1620340105 (virtual work of
    the external moments of a shell with a director).
    """

    example: ClassVar = {"effect": "edge-moment", "region": "x1", "moment": [0, "0.1 N m/m", 0]}

    only_of_kind: ClassVar = "shell"

    effect: Literal["edge-moment"] = "edge-moment"
    region: Surface
    """edge of the shell"""
    moment: Triple[MomentField]
    """moment per length of the undeformed edge about the axes x, y and z"""

    def virtual_work(self, k: Kinematics, v: Any, load: Any, par: Any) -> Any:
        return k.dL(load * k.work_of_moment(par.moment, v), self.region)
