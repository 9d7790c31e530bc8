"""The solution in one direction, and its evaluation from the present state of the equations."""

from dataclasses import dataclass

import numpy as np
from dolfinx.fem import Function

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.source import Floats
from hpcinv.model.cell_means import LayerValues
from hpcinv.model.constraint_report import CavityReport, ConstraintReport, RemoteReport, of_kind
from hpcinv.model.state import State
from hpcinv.model.weak_form import WeakForm
from hpcinv.physics.effects import Direction
from hpcinv.solver.equations import Equations
from hpcinv.solver.linear.selection import Used
from hpcinv.solver.methods.method import Guess, sign_of
from hpcinv.solver.newton import CoarseSolve, Solve


@dataclass(frozen=True, kw_only=True)
class Solution(State):
    """Solution of one direction of an analysis: a state, its evaluation, and the report of its solves.

    Attributes:
        u: displacement ``x - X`` at the mesh's nodes, (n, 3) in m.
        J: mean volume ratio of each cell, piecewise constant.
        cauchy_stress: mean Cauchy stress of each cell in Pa, piecewise constant, (3, 3).
        layer: Cauchy stress (Pa) and volume ratio within the layers of a shell, ``None`` in other bodies.
        prestrain_stress: the same that prestrain alone causes in the body's reference shape, else ``None``.
        J_range: smallest and largest volume ratio at any quadrature point.
        solves: every solve of the method, failed ones included.
        constraints: numbers of loads and supports that the solves found; `job` has them as given ones.
        start: state or shape file where the load path began; empty for the unloaded body.
        coarse: report of the solve on coarser cells before it, ``None`` without one.
    """

    direction: Direction
    u: Floats
    J: Function
    cauchy_stress: Function
    J_range: tuple[float, float]
    strain_energy: float
    solves: tuple[Solve, ...]
    linear: Used | None = None
    constraints: tuple[ConstraintReport, ...] = ()
    prestrain_stress: Function | None = None
    layer: LayerValues | None = None
    start: str = ""
    coarse: CoarseSolve | None = None

    @property
    def state(self) -> str:
        """Name of the state of the body; empty in a job without states."""
        return self.job.state

    @property
    def cavities(self) -> tuple[CavityReport, ...]:
        """Cavities of unknown pressure."""
        return of_kind(self.constraints, CavityReport)

    @property
    def remote_loads(self) -> tuple[RemoteReport, ...]:
        """Regions under remote loads."""
        return of_kind(self.constraints, RemoteReport)

    @property
    def sign(self) -> int:
        """Sign with which ``u`` moves the mesh to the other body."""
        return 1 if self.direction == "forward" else -1

    @property
    def other_nodes(self) -> Floats:
        """Coordinates of the nodes of the computed body, (n, 3) in m."""
        return self.mesh_nodes + self.sign * self.u

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

    def as_guess(self) -> Guess:
        """Return the solution as the initial guess of a similar problem, with its sign if it had only one."""
        pressure = None if self.pressure is None else self.pressure.x.array.copy()
        return Guess(self.displacement.x.array.copy(), pressure, sign_of(self.solves))


def solution_of(
    equations: Equations,
    direction: Direction,
    weak_form: WeakForm,
    solves: tuple[Solve, ...],
    load: float = 1.0,
    linear: Used | None = None,
) -> Solution:
    """Evaluate the equations' present state, a solution at a load factor, in SI units; collective."""
    length, stress = equations.scales.length, equations.scales.stress
    with equations.timings("programs"):
        evaluate = weak_form.means
    with equations.timings("evaluation"):
        equations.put_load(load)
        state = equations.state(load)
        means = evaluate()
        for stress_field in (means.cauchy_stress, means.prestrain_stress):
            if stress_field is not None:
                stress_field.x.array[:] *= stress
        if means.layer is not None:
            means.layer.scale(stress)
        return Solution(
            direction=direction,
            job=state.job,
            mesh_nodes=state.mesh_nodes,
            displacement=state.displacement,
            pressure=state.pressure,
            load=load,
            given_displacement=state.given_displacement,
            u=equations.unknowns.geometry_values(state.displacement),
            J=means.J,
            cauchy_stress=means.cauchy_stress,
            J_range=means.J_range,
            strain_energy=means.strain_energy * stress * length**3,
            solves=solves,
            linear=linear,
            contacts=weak_form.contacts.reports(equations.scales),
            prestrain_stress=means.prestrain_stress,
            layer=means.layer,
        )
