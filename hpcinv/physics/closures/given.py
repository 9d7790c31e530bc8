"""Closure with the tractions of a forward solve."""

from typing import ClassVar

from hpcinv.physics.closures.closure import Closure


class Given(Closure):
    """Pressures and tangential tractions are what the forward solve had, in a round trip that begins with it."""

    name: ClassVar = "given"
    assumes: ClassVar = "the forward solve of the round trip had it, with its friction"
    follows_forward: ClassVar = True
    leaves_open: ClassVar = "does not say where it is unloaded"
