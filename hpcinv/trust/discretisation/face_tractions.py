"""Tractions of a shell's stresses on its faces, compared with the tractions of the loads.

One layer with displacements of degree 2 balances forces and moments through the thickness, but not the normal stress
itself, whose part of degree 2 is too large: in bending it does not vanish on the faces of a curved shell. The same
strain through the thickness changes the other stresses, by less. What the stress of a face lacks of the traction of
the loads there bounds both, for any law, which a finer mesh of one layer does not show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from hpcinv.base.parallel.runtime import on_root
from hpcinv.mesh.body import reorder_to_source
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.mesh.surface_normals import surface_tangents
from hpcinv.results.cell_fields import face_arrays
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations

_MIDDLE, _END = 4 / 6, 1 / 6  # weights of the nodes of a line


@dataclass(frozen=True)
class FaceTractions:
    """Points (2, n, 3) of both faces of the mesh (m), and what their normal stresses lack of the loads (2, n) Pa."""

    points: Floats
    missing: Floats


def face_tractions(equations: Equations, solution: Solution) -> FaceTractions | None:
    """Return the tractions of a shell, the same on all ranks; collective.

    ``None`` where effects that are not loads grow with the load factor: nodal forces of the loads are not known then.
    """
    if not all(effect.is_load for effect in solution.job.effects):
        return None
    body, nodal = equations.body, _nodal_loads(equations, solution)
    stress = face_arrays(body, solution)["cauchy_stress"]
    parts = [reorder_to_source(body, values) for values in (solution.mesh_nodes, solution.current_nodes, stress, nodal)]
    return on_root(body.mesh.comm, lambda: _compared(body.source, *parts))


def _nodal_loads(equations: Equations, solution: Solution) -> Floats:
    """Return nodal forces (n, 3) N of the loads at the local geometry nodes; collective."""
    equations.put(solution)
    equilibrium = equations.equilibrium(equations.weak_form(solution.direction))
    forces = equilibrium.system.forces(0.0) - equilibrium.system.forces(1.0)
    equations.release(equilibrium)
    unknowns, scales = equations.unknowns, equations.scales
    loads = fem.Function(unknowns.displacement_space)
    array = np.zeros_like(unknowns.state.x.array)
    array[: len(forces)] = forces
    loads.x.array.reshape(-1, 3)[:] = array[unknowns.displacement_dofs_of_nodes]
    loads.x.scatter_forward()
    return np.asarray(unknowns.geometry_values(loads) * scales.stress * scales.length**2)


def _compared(source: MeshSource, given: Floats, current: Floats, stress: Floats, nodal: Floats) -> FaceTractions:
    surface = source.midsurface
    assert surface is not None
    count, places = len(surface.points), scalar_element("quadrilateral", 2).points
    weights = np.where(places == 0.5, _MIDDLE, _END).prod(axis=1)
    points, missing = [], []
    for face, sign in ((slice(count), -1.0), (slice(-count, None), 1.0)):
        tangents = surface_tangents(surface.cells, current[face])
        areas = sign * np.cross(tangents[0], tangents[1]) * weights[:, None]
        normals = np.zeros((count, 3))
        np.add.at(normals, surface.cells, areas)
        sizes = np.linalg.norm(normals, axis=1)
        n = normals / sizes[:, None]
        inside = np.einsum("ni,nij,nj->n", n, stress[face].reshape(-1, 3, 3), n)
        outside = (nodal[face] * n).sum(axis=1) / sizes
        points.append(given[face])
        missing.append(np.abs(inside - outside))
    return FaceTractions(np.stack(points), np.stack(missing))
