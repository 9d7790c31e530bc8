"""Solution methods: the direct method, and for inverse problems fixed-point methods with forward solves."""

from hpcinv.effects import Direction
from hpcinv.methods.direct import DirectMethod
from hpcinv.methods.fixed_point import FixedPointMethod
from hpcinv.methods.method import Method
from hpcinv.methods.updates import UPDATES
from hpcinv.solver.observer import SILENT, Observer
from hpcinv.solver.problem import Model


def method_for(model: Model, direction: Direction, observer: Observer = SILENT) -> Method:
    """Return the method of the model's job; forward problems are always solved directly."""
    if direction == "forward" or model.job.method == "direct":
        return DirectMethod(model, direction, observer)
    return FixedPointMethod(model, observer)


__all__ = ["UPDATES", "DirectMethod", "FixedPointMethod", "Method", "method_for"]
