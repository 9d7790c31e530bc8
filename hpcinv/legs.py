"""A leg of an analysis as it is given back, from the state that a solve has left in the model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
from dolfinx import fem

from hpcinv.cellwise import cell_means, quadrature_range
from hpcinv.kernels import JIT_OPTIONS
from hpcinv.result import Leg
from hpcinv.runtime import MPI

if TYPE_CHECKING:
    from hpcinv.effects import Direction
    from hpcinv.equilibrium import Solve
    from hpcinv.model import Model
    from hpcinv.scene import Scene


def leg_of(model: Model, direction: Direction, scene: Scene, solves: tuple[Solve, ...], load: float = 1.0) -> Leg:
    """The model's present state, a solution at a load factor, and what follows from it, in SI units; collective."""
    body, length, stress = model.body, model.scales.length, model.scales.stress
    with model.timings("results"):
        u, p = model.solution()
        degree = model.quadrature_degree
        sigma = cell_means(scene.cauchy_stress, body.mesh, degree)
        sigma.x.array[:] *= stress
        energy = fem.assemble_scalar(fem.form(scene.strain_energy, jit_options=JIT_OPTIONS))
        return Leg(
            direction=direction,
            mesh_nodes=body.mesh.geometry.x * length,
            u=model.unknowns.at_nodes(u),
            displacement=u,
            pressure=p,
            J=cell_means([(scene.J, None)], body.mesh, degree),
            cauchy_stress=sigma,
            J_range=quadrature_range(scene.J, body.mesh, degree),
            strain_energy=body.mesh.comm.allreduce(energy, op=MPI.SUM) * stress * length**3,
            solves=solves,
            load=load,
        )
