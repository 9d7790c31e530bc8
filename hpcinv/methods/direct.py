"""The direct method: equilibrium is formulated on the given body and solved by one continuation in the load."""

from collections.abc import Iterator
from dataclasses import replace

from hpcinv.effects import Direction
from hpcinv.methods.fallbacks import Problem, reach
from hpcinv.methods.method import UNLOADED, Method, Start
from hpcinv.model.outcome import Outcome
from hpcinv.solver.arc_length import ArcLengthSteps
from hpcinv.solver.load_stepping import AdaptiveSteps
from hpcinv.solver.newton import Solve
from hpcinv.solver.observer import SILENT, Observer
from hpcinv.solver.problem import Model


class DirectMethod(Method):
    """Direct method for forward and inverse problems (doi:10.1007/s00366-021-01597-z)."""

    def __init__(self, model: Model, direction: Direction, observer: Observer = SILENT) -> None:
        self.equilibrium = model.equilibrium(model.scene(direction), observer)
        self.problem = Problem(model, direction, self.equilibrium, observer)
        self.steps = model.steps
        if isinstance(self.steps, ArcLengthSteps) and direction != model.job.directions[0]:
            self.steps = replace(self.steps, limit_points=0)  # the way back from the first solution has none

    def solves(self, start: Start = UNLOADED) -> Iterator[Solve]:
        self.reached = start.load
        # The other strategies are chosen for the path that they take, which a guess would skip.
        if start.guess is not None and start.load == 0.0 and isinstance(self.steps, AdaptiveSteps):
            solve = start.guess.solve(self.problem.model, self.equilibrium)
            if solve.outcome.accepted:
                self.reached = 1.0
            else:
                self.equilibrium.system.state.x.array[:] = 0.0
            yield solve
            if solve.outcome.accepted or solve.outcome is Outcome.INTERRUPTED:
                return
        for solve in reach(self.problem, self.steps, load=start.load, passed=start.limit_points):
            if solve.outcome.accepted:
                self.reached = solve.load
            yield solve

    def can_restart_after(self, solve: Solve) -> bool:
        return solve.outcome.accepted

    def min_mesh_J(self) -> float:
        return self.equilibrium.system.min_mesh_J()
