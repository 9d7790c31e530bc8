"""Load path of bodies with unknown pressures of cavities, or with remote loads, whose motions are unknown."""

from collections.abc import Iterator
from functools import partial

from hpcinv.effects import Direction
from hpcinv.methods.method import UNLOADED, Method, Start
from hpcinv.model.cavities import CavityReport, cavity_equations, reports_of
from hpcinv.model.remote_loads import RemoteReport
from hpcinv.solver.bordered_newton import BorderedNewton
from hpcinv.solver.cavity_border import CavityBorder
from hpcinv.solver.equations import Equations
from hpcinv.solver.load_stepping import AdaptiveSteps, target_of
from hpcinv.solver.newton import Solve
from hpcinv.solver.observer import SILENT, Observer
from hpcinv.solver.remote_border import RemoteBorder


class BorderedMethod(Method):
    """Steps in the load factor, which leads from the volumes of the mesh to the given ones, with all loads."""

    def __init__(self, equations: Equations, direction: Direction, observer: Observer = SILENT) -> None:
        weak_form, job = equations.weak_form(direction), equations.job
        self.equilibrium = equations.equilibrium(weak_form, observer)
        self._tolerance = job.solver.tolerance
        self._steps = AdaptiveSteps(job.solver.initial_step, job.solver.minimum_step)
        self._cavities = cavity_equations(job, equations.body, weak_form, equations.scales)
        system = self.equilibrium.system
        self._pressures = [CavityBorder(system, self._cavities)] if self._cavities else []
        self._motions = [RemoteBorder(system, *item, equations.scales) for item in job.remote_loads.items()]

    def solves(self, start: Start = UNLOADED) -> Iterator[Solve]:
        self.reached_load = load = start.load
        names = ["cavities"] * bool(self._pressures) + ["remote loads"] * bool(self._motions)
        newton = BorderedNewton(self.equilibrium, [*self._motions, *self._pressures], " and ".join(names))
        self.check_start(start)
        if load > 0.0:
            self.equilibrium.system.set_load(load)
            for motion in self._motions:
                motion.recover()
                motion.put(load)
            for pressures in self._pressures:
                pressures.recover(load)
        step, forward = self._steps.start(), self.equilibrium.system.weak_form.kinematics.direction == "forward"
        shortened = partial(self._steps.shortened, forward=forward)
        try:
            while load < 1.0:
                target = target_of(load, step, 1)
                # A coarse path costs nothing that the last solve does not correct.
                tolerance = self._tolerance if target == 1.0 else self._steps.path_tolerance
                solve = newton.solve(target, tolerance, start=load, shortened=shortened)
                step = self._steps.next_step(solve, solve.load - load)
                if solve.outcome.accepted:
                    self.reached_load = load = solve.load
                yield solve
                if not solve.outcome.accepted and (step < self._steps.least or solve.outcome.is_final):
                    return
        finally:
            newton.destroy()
            for pressures in self._pressures:
                pressures.destroy()

    def cavities(self) -> tuple[CavityReport, ...]:
        """Return the pressures and volumes of the present state; collective."""
        return reports_of(self._cavities, self.reached_load)

    def remote_loads(self) -> tuple[RemoteReport, ...]:
        """Return the motions of regions under remote loads in the present state; collective."""
        return tuple(motion.report(self.reached_load) for motion in self._motions)

    def can_restart_after(self, solve: Solve) -> bool:
        return solve.outcome.accepted

    def min_mesh_J(self) -> float:
        return self.equilibrium.system.min_mesh_J()
