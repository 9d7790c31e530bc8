"""The inverse problem as a fixed point: put the mesh at X, solve the forward problem for u, and move X by what is left,
the residual ``r = X + u - x``, until the loaded body is the given one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from hpcinv.methods.method import Method
from hpcinv.methods.moving_mesh import MovableMesh
from hpcinv.methods.updates import UPDATES
from hpcinv.model.outcome import Outcome
from hpcinv.solver.equilibrium import Solve
from hpcinv.solver.load_stepping import follow
from hpcinv.solver.observer import SILENT, Observer

if TYPE_CHECKING:
    from hpcinv.methods.update import Floats
    from hpcinv.solver.problem import Model


class FixedPointMethod(Method):
    """Sellier's iteration on the nodes X of the reference body, with the update rule that the job names.

    It ends when the position residual, ``max |X + u - x|`` over the nodes, is at most ``fixed_point.tolerance`` times
    the diagonal of the given body. The mesh is then where it was, and the state is ``u = x - X`` and the pressure of
    the last forward solve: what the direct method leaves, to that tolerance, if the mesh's geometry has the
    displacement's degree. If it has a lower one, only its nodes move, and between them the loaded body is not the given
    one: u is then that of the forward solve, corrected so that ``X = x - u`` at the nodes, and shape and stress have an
    error of their own, which falls with the mesh size and not with the tolerance.

    One set of kernels, one matrix and its symbolic factorization serve all forward solves: coordinates are read when
    forms are assembled.

    Args:
        model: a model on the mesh as the job gives it.
        observer: of the iterations; it may ask to stop.

    Attributes:
        equilibrium: of the forward problem, on the mesh wherever it lies.
        reached: 1 once the position residual is within the tolerance, else 0.
    """

    _least_shrinkage = 0.1  # of the volume at any point, by one step
    _patience = 10  # iterations in which the smallest position residual so far must be beaten

    def __init__(self, model: Model, observer: Observer = SILENT) -> None:
        self.model, self.settings = model, model.job.fixed_point
        self.equilibrium = model.equilibrium(model.scene("forward"), observer)
        with model.timings("set-up"):
            self.mesh = MovableMesh(model.unknowns, model.quadrature_degree)
        rule = UPDATES[model.job.method]
        self._update = rule(self.settings.relaxation, self.settings.memory, self.mesh.inner)
        self._X = self.mesh.given

    def solves(self, load: float = 0.0, *, resumed: bool = False) -> Iterator[Solve]:
        """Yield every forward solve, the last one of each iteration with its ``position_residual``.

        Whenever it yields, the mesh is where the job has it; whenever it yields a position residual, the state is
        ``u = x - X`` of the body that the search goes on from. The last solve is accepted, or tells why the
        search ended.

        Args:
            resumed: begin with the body and the displacement of the model's state, not with the given body, unloaded.
        """
        if load == 1.0:
            self.reached = 1.0
            return
        mesh = self.mesh
        self._X = self._body_of_state() if resumed else mesh.given
        residuals: list[float] = []
        while True:
            for solve in self._forward(warm=self.settings.warm_start if residuals else resumed):
                last = solve
                if solve.load < 1 or not solve.outcome.accepted:
                    yield solve
            if last.outcome is Outcome.INTERRUPTED:
                return
            if not last.outcome.accepted:
                yield Solve(last.load, Outcome.FORWARD_FAILED, (), 0)
                return
            with self.model.timings("fixed-point update"):
                X = self._X
                r = X + mesh.displacement() - mesh.given
                residuals.append(mesh.largest(r))
                end = self._end(last, residuals)
                if end is None and not self._move(self._update.step(X, r)):
                    end = Outcome.FIXED_POINT_DIVERGED
                mesh.correct_displacement(X - self._X - r)  # to x - X
            self.reached = 1.0 if end is not None and end.accepted else 0.0
            yield replace(last, outcome=end or last.outcome, position_residual=residuals[-1] * self.model.scales.length)
            if end is not None:
                return

    def can_restart_after(self, solve: Solve) -> bool:
        return solve.position_residual is not None

    def min_mesh_J(self) -> float:
        """Smallest determinant of the map from the given to the reference body, as `Equilibrium` has it."""
        return self.mesh.least_volume_ratio(self._X)

    def _body_of_state(self) -> Floats:
        X = self.mesh.given - self.mesh.displacement()
        if self.mesh.least_volume_ratio(X) > 0:
            return X
        self.equilibrium.system.state.x.array[:] = 0.0
        return self.mesh.given

    def _forward(self, *, warm: bool) -> Iterator[Solve]:
        """Solve the forward problem of the body X; the mesh is there only while it is solved."""
        attempts = self._attempts(warm)
        while True:
            with self.mesh.at(self._X):
                solve = next(attempts, None)
            if solve is None:
                return
            yield solve

    def _attempts(self, warm: bool) -> Iterator[Solve]:
        """At full load from the displacement known so far, then from no load."""
        equilibrium, tolerance = self.equilibrium, self.model.job.solver.tolerance
        if warm:
            solve = equilibrium.solve(1.0, tolerance)
            yield solve
            if solve.outcome.accepted or solve.outcome is Outcome.INTERRUPTED:
                return
        equilibrium.system.state.x.array[:] = 0.0
        yield from follow(equilibrium, self.model.steps, tolerance)

    def _end(self, solve: Solve, residuals: list[float]) -> Outcome | None:
        """How the search ends with these position residuals, ``None`` if it goes on."""
        if residuals[-1] <= self.settings.tolerance * self.mesh.diagonal:
            return solve.outcome
        if len(residuals) > self._patience and min(residuals[-self._patience :]) >= min(residuals[: -self._patience]):
            return Outcome.FIXED_POINT_DIVERGED
        return Outcome.FIXED_POINT_LIMIT if len(residuals) >= self.settings.maximum_iterations else None

    def _move(self, step: Floats) -> bool:
        """Move the body by a step, or by a part of it that turns no element inside out; whether there is one."""
        for halvings in range(10):
            X = self._X + step / 2**halvings
            if self.mesh.least_volume_ratio(X, of=self._X) > self._least_shrinkage:
                self._X = X
                return True
        return False
