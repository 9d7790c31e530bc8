"""A leg of an analysis as it is given back, from the state that a solve has left in the model."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hpcinv.results.result import Leg

if TYPE_CHECKING:
    from hpcinv.effects import Direction
    from hpcinv.model.scene import Scene
    from hpcinv.solver.equilibrium import Solve
    from hpcinv.solver.linear.selection import Used
    from hpcinv.solver.problem import Model


def leg_of(
    model: Model,
    direction: Direction,
    scene: Scene,
    solves: tuple[Solve, ...],
    load: float = 1.0,
    linear: Used | None = None,
) -> Leg:
    """The model's present state, a solution at a load factor, and what follows from it, in SI units; collective."""
    body, length, stress = model.body, model.scales.length, model.scales.stress
    with model.timings("compile"):
        means = scene.means
    with model.timings("evaluation"):
        u, p = model.solution()
        sigma = means.cauchy_stress()
        sigma.x.array[:] *= stress
        return Leg(
            direction=direction,
            mesh_nodes=body.mesh.geometry.x * length,
            u=model.unknowns.at_nodes(u),
            displacement=u,
            pressure=p,
            J=means.J(),
            cauchy_stress=sigma,
            J_range=means.J_at_points.range(),
            strain_energy=means.strain_energy() * stress * length**3,
            solves=solves,
            load=load,
            linear=linear,
        )
