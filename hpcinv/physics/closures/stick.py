"""Closure of bodies that have not slid on each other."""

from typing import ClassVar

from hpcinv.physics.closures.closure import Closure


class Stick(Closure):
    """The unloaded bodies touch at the same points as the loaded ones, whatever tractions that takes."""

    name: ClassVar = "stick"
    assumes: ClassVar = (
        "the unloaded bodies touch each other, too, where they press, and have not slid there, whatever tractions that"
        " takes"
    )
    finds_pressure: ClassVar = True
    friction: ClassVar = "with"
    bound: ClassVar = "rough"
