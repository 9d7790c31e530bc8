"""Closure of bodies that slid as one load step lets them."""

from typing import ClassVar

from hpcinv.physics.closures.closure import Closure


class Coulomb(Closure):
    """The unloaded bodies touch where the loaded ones press, and friction is what one load step brings."""

    name: ClassVar = "coulomb"
    assumes: ClassVar = (
        "the unloaded bodies touch each other, too, where they press, and friction is what a forward solve in one load"
        " step brings"
    )
    finds_pressure: ClassVar = True
    friction: ClassVar = "with"
    bound: ClassVar = "coulomb"
