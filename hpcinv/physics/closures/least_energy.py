"""Closure of unloaded bodies that store the least energy in the given shape."""

from typing import ClassVar

from hpcinv.physics.closures.closure import Closure


class LeastEnergy(Closure):
    """Of all pressures that do not pull, and whose unloaded bodies do not overlap, the ones that strain them least.

    With friction, tangential tractions within the friction cone are chosen likewise.
    """

    name: ClassVar = "least-energy"
    assumes: ClassVar = "the bodies store the least elastic energy, do not overlap unloaded, and do not pull"
    searched_from: ClassVar = {"without": "conforming", "with": "stick"}
