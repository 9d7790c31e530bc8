"""An effect for the fuzzer."""

from typing import Any, ClassVar, Literal

from hpcinv.base.quantity import Force
from hpcinv.physics.effects.effect import Effect


class Push(Effect):
    example: ClassVar = {"effect": "fuzz-push", "force": "1 N"}

    effect: Literal["fuzz-push"] = "fuzz-push"
    force: Force

    def virtual_work(self, k: Any, v: Any, load: Any, par: Any) -> Any:
        return k.dV(load * par.force * v[0])
