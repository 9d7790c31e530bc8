"""The direct method: equilibrium is written on the body that is given, and one continuation in the load solves it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from hpcinv.continuation import follow
from hpcinv.methods.method import Method

if TYPE_CHECKING:
    from hpcinv.effects import Direction
    from hpcinv.equilibrium import Solve
    from hpcinv.model import Model


class Direct(Method):
    """Forward and inverse problems alike (doi:10.1007/s00366-021-01597-z)."""

    def __init__(self, model: Model, direction: Direction, stop_asked: Callable[[], bool]) -> None:
        self.model = model
        self.equilibrium = model.equilibrium(model.scene(direction), stop_asked)

    def solves(self, load: float, *, resumed: bool) -> Iterator[Solve]:
        self.reached = load
        for solve in follow(self.equilibrium, self.model.steps, self.model.job.solver.tolerance, load=load):
            if solve.outcome.accepted:
                self.reached = solve.load
            yield solve

    def can_restart_after(self, solve: Solve) -> bool:
        return solve.outcome.accepted

    def min_mesh_J(self) -> float:
        return self.equilibrium.min_mesh_J()
