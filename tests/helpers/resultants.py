"""Forces and torques on a body in whatever state, from the assembled residual: rigid motions do no internal work."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.job import Job
from hpcinv.mesh import build_body
from hpcinv.solver.equations import Equations


def wave(points: np.ndarray) -> np.ndarray:
    """Some displacement (m) at points (n, 3) m."""
    x, y, z = points.T
    return 0.05 * np.stack([np.sin(3 * y + z), np.cos(2 * x - z) + x * y, np.sin(2 * x) + y**2 - x * z], axis=1)


def bend(points: np.ndarray) -> np.ndarray:
    """Another one."""
    return wave(np.roll(points, 1, axis=1))


class Loaded:
    """The whole load on a body in a state of the test's choice, which need not be in equilibrium.

    Args:
        bend: displacement (m) of mesh nodes (n, 3) m, which moves the mesh of the job first.
        state: the displacement (m) at dofs (n, 3) m of the bent mesh.
    """

    def __init__(self, job: Job, direction: Any, state: Any, bend: Any = np.zeros_like) -> None:
        self.body = build_body(job.mesh, job.regions, MPI.COMM_SELF, resolve=job.resolve)
        length, nodes = self.body.length_scale, self.body.mesh.geometry.x
        nodes[:] += bend(nodes * length) / length
        self.model = Equations(job, self.body, Timings())
        self.weak_form = self.model.weak_form(direction)
        self.model.put_load(1.0)
        unknowns = self.weak_form.unknowns
        points = unknowns.space.tabulate_dof_coordinates()
        unknowns.state.x.array[:] = (state(points * length) / length).ravel()
        u = unknowns.state.x.array.reshape(-1, 3)
        self.x = points + u if direction == "forward" else points
        self.pull = -fem.assemble_vector(fem.form(self.weak_form.residual)).array.reshape(-1, 3)

    def volume(self) -> tuple[float, np.ndarray]:
        """Of the current body (m³), and its first moments (m⁴)."""
        mesh, length = self.body.mesh, self.body.length_scale
        x, u, J = ufl.SpatialCoordinate(mesh), self.weak_form.unknowns.u, 1
        if self.weak_form.kinematics.direction == "forward":
            x, J = x + u, ufl.det(ufl.Identity(3) + ufl.grad(u))
        volume, *moment = (
            fem.assemble_scalar(fem.form(part * J * ufl.dx(mesh, degree=8))) for part in (ufl.as_ufl(1.0), *x)
        )
        return volume * length**3, np.array(moment) * length**4

    @property
    def force(self) -> np.ndarray:
        """N."""
        scales = self.model.scales
        force: np.ndarray = self.pull.sum(axis=0) * scales.stress * scales.length**2
        return force

    def torque(self, about: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
        """N m, about a point (m)."""
        scales = self.model.scales
        arm = self.x - np.array(about) / scales.length
        torque: np.ndarray = np.cross(arm, self.pull).sum(axis=0) * scales.stress * scales.length**3
        return torque

    @property
    def swelling(self) -> float:
        """Work (J) in the virtual displacement ``v = x``: work of the load minus work of the stresses."""
        scales = self.model.scales
        return float((self.pull * self.x).sum() * scales.stress * scales.length**3)
