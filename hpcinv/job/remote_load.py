"""Remote loads of a job: a force and a moment on a region that moves as a rigid body, by a motion that is found."""

from __future__ import annotations

from typing import Annotated

from hpcinv.base.quantity.parameter_paths import Number
from hpcinv.base.quantity.quantity import Length, Quantity, quantities_of
from hpcinv.base.quantity.schema import KeyPath, Spec, Triple


class RemoteLoad(Spec):
    """Force and moment on a region that moves as a rigid body, by an unknown motion.

    Both keep their direction in space.
    """

    force: Triple[Annotated[float, Quantity("N")]] = (0.0, 0.0, 0.0)
    """force on the region, along x, y and z, at the point 'about'"""
    moment: Triple[Annotated[float, Quantity("N m")]] = (0.0, 0.0, 0.0)
    """moment on the region about the point 'about', about x, y and z"""
    about: Triple[Length]
    """point in the given mesh, inside or outside of the body, which moves with the region"""

    def numbers(self) -> dict[KeyPath, Number | str]:
        """All numbers by place."""
        return {
            (name, i): Number(x, dimension)
            for name, dimension in quantities_of(type(self)).items()
            for i, x in enumerate(getattr(self, name))
        }
