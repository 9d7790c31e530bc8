"""Centrifugal load."""

from typing import Any, ClassVar, Literal

from pydantic import ValidationInfo

from hpcinv.base.quantity import DensityField, Dimensionless, Faults, Frequency, Length, Triple
from hpcinv.physics.effects.effect import Configuration, Effect, Kinematics


class Centrifugal(Effect):
    """Centrifugal force on a body in steady rotation, in the rotating frame.

    ``∫ rho omega² r·v`` over the volume, where ``r`` is the vector from the axis to the current position, normal to the
    axis. The load factor scales ``omega²``. ``density_in`` is as for gravity.
    """

    example: ClassVar = {
        "effect": "centrifugal",
        "angular_velocity": "30 rpm",
        "axis": [0, 0, 1],
        "centre": [0, 0, 0],
        "density": "1 g/cm^3",
    }

    attached: ClassVar = frozenset({"density"})

    effect: Literal["centrifugal"] = "centrifugal"
    angular_velocity: Frequency
    """angular velocity, such as 300 rpm or 5 rad/s"""
    axis: Triple[Dimensionless]
    """direction of the axis of rotation, of any length"""
    centre: Triple[Length] = (0.0, 0.0, 0.0)
    """a point on the axis"""
    density: DensityField
    """mass density"""
    density_in: Configuration = "reference"
    """configuration whose volume the density refers to"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if not any(self.axis):
            yield ("axis",), "must not be zero"

    def virtual_work(self, k: Kinematics, v: Any, load: Any, par: Any) -> Any:
        r = k.x - par.centre
        height = sum(par.axis[i] * r[i] for i in range(3)) / sum(a * a for a in par.axis)
        arm = sum((r[i] - height * par.axis[i]) * v[i] for i in range(3))
        work = load * par.density * par.angular_velocity**2 * arm
        return k.dm(work, self.density_in)
