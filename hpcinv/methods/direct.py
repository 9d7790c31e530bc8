"""The direct method: equilibrium is written on the body that is given, and one continuation in the load solves it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from hpcinv.methods.fallbacks import Problem, reach
from hpcinv.methods.method import Method
from hpcinv.model.outcome import Outcome
from hpcinv.solver.arc_length import ArcLengthSteps
from hpcinv.solver.load_stepping import AdaptiveSteps
from hpcinv.solver.observer import SILENT, Observer

if TYPE_CHECKING:
    from hpcinv.effects import Direction
    from hpcinv.solver.equilibrium import Solve
    from hpcinv.solver.problem import Model


class DirectMethod(Method):
    """Forward and inverse problems alike (doi:10.1007/s00366-021-01597-z)."""

    def __init__(self, model: Model, direction: Direction, observer: Observer = SILENT) -> None:
        self.equilibrium = model.equilibrium(model.scene(direction), observer)
        self.problem = Problem(model, direction, self.equilibrium, observer)
        self.steps = model.steps
        if isinstance(self.steps, ArcLengthSteps) and direction != model.job.directions[0]:
            self.steps = replace(self.steps, limit_points=0)  # the body that the first direction found has one way back

    def solves(self, load: float, *, resumed: bool) -> Iterator[Solve]:
        self.reached = load
        # Other strategies are asked for because of the path that they take.
        if self.guess is not None and load == 0.0 and isinstance(self.steps, AdaptiveSteps):
            self.guess.begin(self.problem.model)
            solve = self.guess.follow(self.equilibrium, self.problem.model.job.solver.tolerance)
            if solve.outcome.accepted:
                self.reached = 1.0
            else:
                self.equilibrium.system.state.x.array[:] = 0.0
            yield solve
            if solve.outcome.accepted or solve.outcome is Outcome.INTERRUPTED:
                return
        for solve in reach(self.problem, self.steps, load=load, turned=self.turned):
            if solve.outcome.accepted:
                self.reached = solve.load
            yield solve

    def can_restart_after(self, solve: Solve) -> bool:
        return solve.outcome.accepted

    def min_mesh_J(self) -> float:
        return self.equilibrium.system.min_mesh_J()
