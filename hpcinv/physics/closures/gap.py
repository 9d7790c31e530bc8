"""Closure of unloaded bodies with a known gap."""

from typing import ClassVar

from hpcinv.physics.closures.closure import Closure


class Gap(Closure):
    """The unloaded bodies are a given distance apart where the loaded ones press."""

    name: ClassVar = "gap"
    assumes: ClassVar = "the unloaded bodies are 'rest_gap' apart where they press"
    keys: ClassVar = ("rest_gap",)
    finds_pressure: ClassVar = True
    friction: ClassVar = "without"
