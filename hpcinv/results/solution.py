"""The solution in one direction, and its evaluation from the state of the model."""

from dataclasses import dataclass

import numpy as np
from dolfinx.fem import Function

from hpcinv.effects import Direction
from hpcinv.mesh.source import Floats
from hpcinv.methods.nested_iteration import CoarseSolve
from hpcinv.model.contacts import ContactReport
from hpcinv.model.scene import Scene
from hpcinv.parallel.runtime import MPI
from hpcinv.solver.linear.selection import Used
from hpcinv.solver.newton import Solve
from hpcinv.solver.problem import Model


@dataclass(frozen=True)
class Solution:
    """Solution of one direction of an analysis.

    Attributes:
        mesh_nodes: coordinates of the local geometry nodes of the mesh it was solved on, (n, 3) in m.
        u: displacement ``x - X`` at those nodes, (n, 3) in m.
        displacement: ``x - X`` as a finite-element function, in m.
        pressure: pressure of the mixed form in Pa, else ``None``.
        J: mean volume ratio of each cell, piecewise constant.
        cauchy_stress: mean Cauchy stress of each cell in Pa, piecewise constant, (3, 3).
        prestrain_stress: the same that prestrain alone causes in the body's reference shape, else ``None``.
        J_range: smallest and largest volume ratio at any quadrature point.
        solves: every solve of the method, failed ones included.
        load: load factor that was reached, 1 at the end.
        contacts: contacts of the job, in its order.
        state: name of the state of the body; empty in a job without states.
        start: name of the state at which the load path began; empty if that was the unloaded body.
        coarse: report of the solve on coarser cells before it, ``None`` without one.
    """

    direction: Direction
    mesh_nodes: Floats
    u: Floats
    displacement: Function
    pressure: Function | None
    J: Function
    cauchy_stress: Function
    J_range: tuple[float, float]
    strain_energy: float
    solves: tuple[Solve, ...]
    load: float = 1.0
    linear: Used | None = None
    contacts: tuple[ContactReport, ...] = ()
    prestrain_stress: Function | None = None
    state: str = ""
    start: str = ""
    coarse: CoarseSolve | None = None

    @property
    def sign(self) -> int:
        """Sign with which ``u`` moves the mesh to the other body."""
        return 1 if self.direction == "forward" else -1

    @property
    def other_nodes(self) -> Floats:
        """Coordinates of the nodes of the computed body, (n, 3) in m."""
        return self.mesh_nodes + self.sign * self.u

    @property
    def fields(self) -> tuple[Function, Function | None]:
        """Displacement (m) and pressure (Pa)."""
        return self.displacement, self.pressure

    @property
    def reference_nodes(self) -> Floats:
        return self.mesh_nodes if self.direction == "forward" else self.other_nodes

    @property
    def current_nodes(self) -> Floats:
        return self.other_nodes if self.direction == "forward" else self.mesh_nodes

    @property
    def largest_displacement(self) -> float:
        """Largest norm of ``u`` over the nodes of all ranks, in m; collective."""
        comm = self.displacement.function_space.mesh.comm
        return float(comm.allreduce(float(np.linalg.norm(self.u, axis=1).max(initial=0.0)), op=MPI.MAX))

    @property
    def factorizations(self) -> int:
        return sum(s.factorizations for s in self.solves)


def solution_of(
    model: Model,
    direction: Direction,
    scene: Scene,
    solves: tuple[Solve, ...],
    load: float = 1.0,
    linear: Used | None = None,
) -> Solution:
    """Evaluate the model's present state, a solution at a load factor, in SI units; collective."""
    body, length, stress = model.body, model.scales.length, model.scales.stress
    with model.timings("compile"):
        evaluate = scene.means
    with model.timings("evaluation"):
        scene.parameters.set_load(load)
        u, p = model.solution()
        means = evaluate()
        for one in (means.cauchy_stress, means.prestrain_stress):
            if one is not None:
                one.x.array[:] *= stress
        return Solution(
            direction=direction,
            mesh_nodes=body.mesh.geometry.x * length,
            u=model.unknowns.at_nodes(u),
            displacement=u,
            pressure=p,
            J=means.J,
            cauchy_stress=means.cauchy_stress,
            J_range=means.J_range,
            strain_energy=means.strain_energy * stress * length**3,
            solves=solves,
            load=load,
            linear=linear,
            contacts=scene.contacts.reports(model.scales),
            prestrain_stress=means.prestrain_stress,
            state=model.job.state,
        )
