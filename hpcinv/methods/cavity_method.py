"""Load path of bodies with cavities whose pressures are unknown: given volumes, or amounts of gas."""

from collections.abc import Iterator
from functools import partial

from hpcinv.effects import Direction
from hpcinv.methods.method import UNLOADED, Method, Start
from hpcinv.model.cavities import CavityReport, cavity_equations, reports_of
from hpcinv.solver.cavity_newton import CavityNewton
from hpcinv.solver.equations import Equations
from hpcinv.solver.load_stepping import AdaptiveSteps, target_of
from hpcinv.solver.newton import Solve
from hpcinv.solver.observer import SILENT, Observer


class CavityMethod(Method):
    """Steps in the load factor, which leads from the volumes of the mesh to the given ones, with all loads."""

    def __init__(self, equations: Equations, direction: Direction, observer: Observer = SILENT) -> None:
        scene = equations.scene(direction)
        self.equilibrium = equations.equilibrium(scene, observer)
        self._tolerance = equations.job.solver.tolerance
        solver = equations.job.solver
        self._steps = AdaptiveSteps(solver.initial_step, solver.minimum_step)
        self._cavities = cavity_equations(equations.job, equations.body, scene, equations.scales)

    def solves(self, start: Start = UNLOADED) -> Iterator[Solve]:
        self.reached = load = start.load
        newton = CavityNewton(self.equilibrium, self._cavities)
        if load > 0.0:
            newton.recover_pressures(load)
        step, forward = self._steps.start(), self.equilibrium.system.scene.kinematics.direction == "forward"
        shortened = partial(self._steps.shortened, forward=forward)
        try:
            while load < 1.0:
                target = target_of(load, step, 1)
                # A coarse path costs nothing that the last solve does not correct.
                tolerance = self._tolerance if target == 1.0 else self._steps.path_tolerance
                solve = newton.solve(target, tolerance, start=load, shortened=shortened)
                step = self._steps.next_step(solve, solve.load - load)
                if solve.outcome.accepted:
                    self.reached = load = solve.load
                yield solve
                if not solve.outcome.accepted and (step < self._steps.least or solve.outcome.is_final):
                    return
        finally:
            newton.destroy()

    def cavities(self) -> tuple[CavityReport, ...]:
        """Return the pressures and volumes of the present state; collective."""
        return reports_of(self._cavities, self.reached)

    def can_restart_after(self, solve: Solve) -> bool:
        return solve.outcome.accepted

    def min_mesh_J(self) -> float:
        return self.equilibrium.system.min_mesh_J()
