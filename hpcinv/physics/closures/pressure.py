"""Closure with a given pressure."""

from typing import Any, ClassVar

from hpcinv.base.quantity.schema import Faults
from hpcinv.base.quantity.spatial_fields import ByFormula, ByRegion
from hpcinv.physics.closures.closure import Closure


class Pressure(Closure):
    """The job gives the pressure on the given shape, and the gap of the unloaded bodies follows."""

    name: ClassVar = "pressure"
    assumes: ClassVar = "it is the given 'pressure' where the given bodies touch"
    keys: ClassVar = ("pressure",)
    leaves_open: ClassVar = "need not balance its loads, and does not say where it is unloaded"
    friction: ClassVar = "without"

    @classmethod
    def faults(cls, contact: Any) -> Faults:
        pressure = contact.pressure
        if isinstance(pressure, ByRegion):
            yield (
                ("pressure",),
                "must be one number, a formula of x, y and z, or an array at nodes: regions are of cells",
            )
        elif isinstance(pressure, ByFormula) and not pressure.formula.names.isdisjoint("XYZ"):
            yield ("pressure",), "must be a formula of x, y and z: the unloaded bodies follow from it"
        elif isinstance(pressure, float) and pressure < 0:
            yield ("pressure",), "must not be negative: bodies in contact do not pull"
