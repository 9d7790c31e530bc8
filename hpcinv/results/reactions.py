"""Reactions: force and moment that the supports of a region exert on the body.

The residual ``R = internal - external nodal forces`` vanishes at free displacements. Where a support prescribes one, R
is the nodal force that the support exerts on the body. In either direction the virtual displacements move the
current body: R are forces in space, and the arms of their moments are current positions.
"""

from collections.abc import Iterable

import numpy as np

from hpcinv.job.sections import QuantityOfInterest
from hpcinv.parallel.runtime import MPI
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations


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

    The equations are in the state of the solution, which has reached the full load.
    """
    equilibrium = equations.equilibrium(equations.weak_form(solution.direction))
    residual = equilibrium.system.forces(1.0)
    equations.release(equilibrium)

    unknowns, length = equations.unknowns, equations.scales.length
    dofs = unknowns.owned_displacement_dofs
    unit_force = equations.scales.stress * length**2
    positions = unknowns.owned_displacement_points()
    if solution.direction == "forward":
        positions = positions + unknowns.state.x.array[dofs].reshape(-1, 3)
    positions = positions * length

    vectors_by_name: dict[str, list[float]] = {}
    for quantity in quantities:
        # Two supports on one region prescribe different components of the same nodes.
        vectors = equations.supports.held_part(residual, {quantity.on or ""})[dofs].reshape(-1, 3) * unit_force
        if quantity.is_moment:
            vectors = np.cross(positions - np.array(quantity.about or (0.0, 0.0, 0.0)), vectors)
        comm = equations.body.mesh.comm
        vectors_by_name[quantity.name] = [
            float(comm.allreduce(float(component.sum()), op=MPI.SUM)) for component in vectors.T
        ]
    return vectors_by_name
