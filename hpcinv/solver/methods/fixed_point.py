"""The inverse problem as a fixed-point problem for the nodes X of the reference body.

Each iteration solves the forward problem on the mesh at X for u, and moves X by an update of the residual
``r = X + u - x``, until the loaded body is the given one.
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np
import ufl
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.updates import UPDATES
from hpcinv.job.settings import FixedPoint as FixedPointSettings
from hpcinv.mesh import Body
from hpcinv.mesh.extent import diagonal
from hpcinv.mesh.source import Floats
from hpcinv.model.outcome import Outcome
from hpcinv.model.quadrature_values import QuadratureValues
from hpcinv.model.spaces import Unknowns
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium_path import EquilibriumPath, Solves
from hpcinv.solver.methods.method import UNLOADED, Method, Start
from hpcinv.solver.newton import Solve
from hpcinv.solver.observer import SILENT, Observer


class FixedPointMethod(Method):
    """Sellier's iteration on the nodes X of the reference body, with the update rule that the job names.

    It ends when the position residual, ``max |X + u - x|`` over the nodes, is at most ``fixed_point.tolerance`` times
    the diagonal of the given body. The mesh is then at the given coordinates, and the state is ``u = x - X`` and the
    pressure of the last forward solve. This is the solution of the direct method, to that tolerance, if the mesh's
    geometry has the degree of the displacement. If it has a lower one, only its nodes move, and between them the loaded
    body differs from the given one: u is the displacement of the forward solve, corrected so that ``X = x - u`` at the
    nodes, and shape and stress have an additional error, which decreases with the mesh size and not with the tolerance.

    One set of kernels, one matrix and its symbolic factorization serve all forward solves: coordinates are read when
    forms are assembled.

    Args:
        equations: on the mesh at the coordinates of the job.
        rule: name of the update rule, by default the job's.
        settings: by default the job's.

    Attributes:
        equilibrium: equations of the forward problem, at the present coordinates of the mesh.
        reached_load: 1 once the position residual is within the tolerance, else 0.
    """

    _least_volume_ratio = 0.1  # of one step, at any point
    _stagnation = 10  # number of iterations without a smaller position residual after which it has diverged

    def __init__(
        self,
        equations: Equations,
        observer: Observer = SILENT,
        rule: str = "",
        settings: FixedPointSettings | None = None,
    ) -> None:
        self.equations, self.settings = equations, settings or equations.job.fixed_point
        self.equilibrium = equations.equilibrium(equations.weak_form("forward"), observer)
        with equations.timings("set-up"):
            self.mesh = MovableMesh(equations.body, equations.unknowns, equations.quadrature_degree)
        update = UPDATES[rule or equations.job.method]
        self._update = update(self.settings.relaxation, self.settings.memory, self.mesh.inner)
        self._X = self.mesh.x

    def solves(self, start: Start = UNLOADED) -> Solves:
        """Yield every forward solve, the last one of each iteration with its ``position_residual``.

        After a solve with a position residual the state is ``u = x - X`` of the next body X. A search that is resumed
        from a solution begins with its body and displacement, others with the given body, unloaded.
        """
        resumed = start.solution is not None
        if start.load == 1.0:
            self.reached_load = 1.0
            return
        mesh = self.mesh
        self._X = self._body_of_state() if resumed else mesh.x
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
            with self.equations.timings("fixed-point update"):
                X = self._X
                r = X + mesh.displacement() - mesh.x
                residuals.append(mesh.largest(r))
                end = self._end(last, residuals)
                if end is None and not self._move(self._update.step(X, r)):
                    end = Outcome.FIXED_POINT_DIVERGED
                self.equations.put_displacement(mesh.corrected_displacement(X - self._X - r))  # x - X
            self.reached_load = 1.0 if end is not None and end.accepted else 0.0
            yield replace(
                last, outcome=end or last.outcome, position_residual=residuals[-1] * self.equations.scales.length
            )
            if end is not None:
                return

    def can_restart_after(self, solve: Solve) -> bool:
        return solve.position_residual is not None

    def min_mesh_J(self) -> float:
        """Return the smallest determinant of the map from the given to the reference body."""
        return self.mesh.least_volume_ratio(self._X)

    def _body_of_state(self) -> Floats:
        X = self.mesh.x - self.mesh.displacement()
        if self.mesh.least_volume_ratio(X) > 0:
            return X
        self.equations.unload()
        return self.mesh.x

    def _forward(self, *, warm: bool) -> Iterator[Solve]:
        """Solve the forward problem of the body X; the mesh lies at X only during the solves."""
        solves = self._solves_at_X(warm)
        while True:
            with self.mesh.at(self._X):
                solve = next(solves, None)
            if solve is None:
                return
            yield solve

    def _solves_at_X(self, warm: bool) -> Iterator[Solve]:
        """Solve at full load from the last displacement if ``warm``, then from the unloaded body."""
        equilibrium, tolerance = self.equilibrium, self.equations.job.solver.tolerance
        if warm:
            solve = equilibrium.solve(1.0, tolerance)
            yield solve
            if solve.outcome.accepted or solve.outcome is Outcome.INTERRUPTED:
                return
        self.equations.unload()
        yield from EquilibriumPath(equilibrium, tolerance, self.equations.job.case_count).follow(self.equations.steps)

    def _end(self, solve: Solve, residuals: list[float]) -> Outcome | None:
        """Return the outcome of the search with these position residuals, ``None`` if it continues."""
        if residuals[-1] <= self.settings.tolerance * self.mesh.diagonal:
            return solve.outcome
        if len(residuals) > self._stagnation and min(residuals[-self._stagnation :]) >= min(
            residuals[: -self._stagnation]
        ):
            return Outcome.FIXED_POINT_DIVERGED
        return Outcome.FIXED_POINT_LIMIT if len(residuals) >= self.settings.maximum_iterations else None

    def _move(self, step: Floats) -> bool:
        """Move the body by a step, halved until no element turns inside out; return whether that succeeded."""
        for halvings in range(10):
            X = self._X + step / 2**halvings
            if self.mesh.least_volume_ratio(X, other=self._X) > self._least_volume_ratio:
                self._X = X
                return True
        return False


class MovableMesh:
    """Geometry nodes of a mesh, and the displacement at these nodes.

    A body is an array ``X`` of the positions of the local nodes, (n, 3) in scaled lengths, ghosts included.

    Attributes:
        x: the given body, which is the current one.
        diagonal: of its bounding box, in scaled lengths.
    """

    def __init__(self, body: Body, unknowns: Unknowns, quadrature_degree: int) -> None:
        self.body, self.unknowns, self.mesh = body, unknowns, body.mesh
        geometry = self.mesh.geometry
        self.x: Floats = body.nodes / body.length_scale
        self.diagonal = diagonal(self.mesh.comm, self.x)
        self._owned = slice(geometry.index_map().size_local)
        self._nodal = fem.Function(unknowns.nodal_space)
        self._dof_of_node = np.empty(len(self.x), dtype=np.int32)
        self._dof_of_node[geometry.dofmaps[0]] = self._nodal.function_space.dofmap.list
        self._jacobian = QuadratureValues(ufl.JacobianDeterminant(self.mesh), self.mesh, quadrature_degree)
        self._given_jacobian = self._jacobians(self.x)

    def at(self, X: Floats) -> AbstractContextManager[None]:
        """Return the context in which the mesh is at a body."""
        return self.body.at(X * self.body.length_scale)

    def displacement(self) -> Floats:
        """Return the displacement of the present state at the nodes, the same on all ranks that share a node."""
        return self.unknowns.geometry_values(self.unknowns.displacement())

    def corrected_displacement(self, change: Floats) -> Floats:
        """Return the present displacement plus a field of the geometry's degree, which is given at the nodes."""
        self._nodal.x.array.reshape(-1, 3)[self._dof_of_node] = change
        u = fem.Function(self.unknowns.displacement_space)
        u.interpolate(self._nodal)
        u.x.scatter_forward()
        return np.asarray(u.x.array + self.unknowns.displacement().x.array)

    def least_volume_ratio(self, X: Floats, other: Floats | None = None) -> float:
        """Return the smallest volume of body ``X`` per volume of another (by default the given one) at any point."""
        jacobians = self._given_jacobian if other is None else self._jacobians(other)
        least = float((self._jacobians(X) / jacobians).min(initial=np.inf))
        return float(self.mesh.comm.allreduce(least, op=MPI.MIN))

    def inner(self, a: Floats, b: Floats) -> float:
        """Return ``Σ a·b`` over all nodes of all ranks."""
        return float(self.mesh.comm.allreduce(float(np.vdot(a[self._owned], b[self._owned])), op=MPI.SUM))

    def largest(self, vectors: Floats) -> float:
        """Return the largest length of a nodal vector over all ranks; not finite if one is not."""
        longest = float(np.linalg.norm(vectors, axis=1).max(initial=0.0))
        return float(self.mesh.comm.allreduce(longest, op=MPI.MAX))

    def _jacobians(self, X: Floats) -> Floats:
        """Return Jacobian determinants of body ``X`` at the quadrature points of the owned cells."""
        with self.at(X):
            values = [v.ravel() for _, v in self._jacobian]
        return np.concatenate([np.empty(0), *values])
