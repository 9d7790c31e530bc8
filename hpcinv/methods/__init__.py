"""Solution methods: the direct one, and for inverse problems fixed points of repeated forward solves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hpcinv.methods.direct import DirectMethod
from hpcinv.methods.fixed_point import FixedPointMethod
from hpcinv.methods.method import Method
from hpcinv.methods.updates import UPDATES
from hpcinv.solver.observer import SILENT, Observer

if TYPE_CHECKING:
    from hpcinv.effects import Direction
    from hpcinv.solver.problem import Model


def method_for(model: Model, direction: Direction, observer: Observer = SILENT) -> Method:
    """The method that the model's job asks for; a forward problem is always solved directly."""
    if direction == "forward" or model.job.method == "direct":
        return DirectMethod(model, direction, observer)
    return FixedPointMethod(model, observer)


__all__ = ["UPDATES", "DirectMethod", "FixedPointMethod", "Method", "method_for"]
