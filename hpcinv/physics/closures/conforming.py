"""Closure of unloaded bodies that touch each other, too."""

from typing import ClassVar

from hpcinv.physics.closures.closure import Closure


class Conforming(Closure):
    """The unloaded bodies touch where the loaded ones press."""

    name: ClassVar = "conforming"
    assumes: ClassVar = "the unloaded bodies touch each other, too, where they press"
    finds_pressure: ClassVar = True
    friction: ClassVar = "without"
