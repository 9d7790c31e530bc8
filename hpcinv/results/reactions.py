"""Reactions: force and moment that the supports of a region exert on the body.

The residual ``R = internal - external nodal forces`` vanishes at free displacements. Where a support prescribes one, R
is the nodal force that the support exerts on the body. In either direction the virtual displacements move the
current body: R are forces in space, and the arms of their moments are current positions.
"""

from collections.abc import Iterable

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations

_ROUNDING = 1e-12
"""Share of the sum of the body's nodal forces below which a reaction is zero.

Measured noise is 1e-17 to 1e-15 of that sum. A higher share would hide reactions that a solve does find.
"""


def contact_values(quantities: Iterable[QuantityOfInterest], solution: Solution) -> dict[str, float | list[float]]:
    """Forces (3 components, N), areas (m²) and penetrations (m) of contacts by the names of quantities."""
    values: dict[str, float | list[float]] = {}
    for quantity in quantities:
        contacts = [contact for contact in solution.contacts if contact.region == quantity.on]
        match quantity.of.source.strip():
            case "contact_force":
                values[quantity.name] = [float(f) for f in np.sum([contact.force for contact in contacts], axis=0)]
            case "contact_area":
                values[quantity.name] = sum(contact.area for contact in contacts)
            case _:
                values[quantity.name] = max(contact.penetration for contact in contacts)
    return values


def reactions(
    quantities: Iterable[QuantityOfInterest], solution: Solution, equations: Equations
) -> dict[str, list[float]]:
    """Reactions by the names of quantities: forces (3 components, N), moments (3 components, N m); collective.

    A component that vanishes by symmetry or balance is zero, not the rounding error of its sum. The equations are in
    the state of the solution, which has reached the full load.
    """
    unknowns, length, comm = equations.unknowns, equations.scales.length, equations.body.mesh.comm
    dofs = unknowns.owned_displacement_dofs
    equilibrium = equations.equilibrium(equations.weak_form(solution.direction))
    without_loads = equilibrium.system.forces(0.0)[dofs]  # balances loads and reactions
    residual = equilibrium.system.forces(1.0)
    equations.release(equilibrium)

    unit_force = equations.scales.stress * length**2
    positions = unknowns.owned_displacement_points()
    if solution.direction == "forward":
        positions = positions + unknowns.state.x.array[dofs].reshape(-1, 3)
    positions = positions * length

    rounding = _ROUNDING * unit_force * float(comm.allreduce(float(np.abs(without_loads).sum()), op=MPI.SUM))

    vectors_by_name: dict[str, list[float]] = {}
    for quantity in quantities:
        # Two supports on one region prescribe different components of the same nodes.
        vectors = equations.supports.held_part(residual, {quantity.on or ""})[dofs].reshape(-1, 3) * unit_force
        least = rounding
        if quantity.is_moment:
            arms = positions - np.array(quantity.about or (0.0, 0.0, 0.0))
            vectors = np.cross(arms, vectors)
            least *= float(comm.allreduce(float(np.abs(arms).max(initial=0.0)), op=MPI.MAX))
        sums = [float(comm.allreduce(float(component.sum()), op=MPI.SUM)) for component in vectors.T]
        vectors_by_name[quantity.name] = [0.0 if abs(value) <= least else value for value in sums]
    return vectors_by_name
