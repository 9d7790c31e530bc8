"""Closure without pressure."""

from typing import ClassVar

from hpcinv.physics.closures.closure import Closure


class Touching(Closure):
    """The bodies only touch."""

    name: ClassVar = "touching"
    assumes: ClassVar = "nothing presses"
    leaves_open: ClassVar = "does not balance its loads"
