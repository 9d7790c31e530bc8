"""An effect for the fuzzer."""

from typing import Any, ClassVar, Literal

from hpcinv.effects.effect import Effect
from hpcinv.quantity import Force


class Push(Effect):
    example: ClassVar = {"effect": "fuzz-push", "force": "1 N"}

    effect: Literal["fuzz-push"] = "fuzz-push"
    force: Force

    def virtual_work(self, k: Any, v: Any, load: Any, par: Any) -> Any:
        return k.dV(load * par.force * v[0])
