"""Methods for a leg: the direct one, and for inverse problems fixed points of repeated forward solves."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from hpcinv.methods.direct import DirectMethod
from hpcinv.methods.fixed_point import FixedPointMethod
from hpcinv.methods.method import Method
from hpcinv.methods.updates import UPDATES

if TYPE_CHECKING:
    from hpcinv.effects import Direction
    from hpcinv.solver.problem import Model


def method_for(model: Model, direction: Direction, stop_asked: Callable[[], bool]) -> Method:
    """The method that the model's job asks for; a forward problem is always solved directly."""
    if direction == "forward" or model.job.method == "direct":
        return DirectMethod(model, direction, stop_asked)
    return FixedPointMethod(model, stop_asked)


__all__ = ["UPDATES", "DirectMethod", "FixedPointMethod", "Method", "method_for"]
