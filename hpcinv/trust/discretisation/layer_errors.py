"""Errors of a shell's quantities that its one layer leaves, which halved cells do not show.

At a clamp the layer is too stiff: a displacement at a distance d from it misses a share of ``t/d``.

One layer with displacements of degree 2 balances forces and moments through the thickness, but not the normal stress
itself, whose part of degree 2 is too large: in bending it does not vanish on the faces of a curved shell. The same
strain through the thickness changes the other stresses, by less. What the stress of a face lacks of the traction of
the loads there bounds both, for any law.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from dolfinx import fem

from hpcinv.base.parallel.runtime import on_root
from hpcinv.job.quantity_of_interest import QuantityOfInterest, QuantityValue
from hpcinv.job.vocabulary import LENGTH, STRESS
from hpcinv.mesh import Body
from hpcinv.mesh.body import reorder_to_source, source_node_values
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.mesh.surface_normals import surface_tangents
from hpcinv.results.cell_fields import face_arrays
from hpcinv.results.quantities_of_interest import owned_nodes
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.discretisation.estimate import LayerError

CLAMPED = 0.05
"""Error of a displacement, relative to its size, by ``t/d``; raised, bars of clamped shells are longer."""
_DIRECT = 10_000_000  # distances up to which none is left out; raised, searches take longer than the import of SciPy
_CHUNK = 100_000  # distances that are computed at once; raised, they take more memory

_MIDDLE, _END = 4 / 6, 1 / 6  # weights of the nodes of a line


def layer_errors(
    equations: Equations,
    solution: Solution,
    quantities: Sequence[QuantityOfInterest],
    computed: Mapping[str, QuantityValue],
) -> dict[str, LayerError]:
    """Return the errors of those quantities of a shell that have one; collective.

    Args:
        computed: values of the quantities.
    """
    placed = [q for q in quantities if q.name in computed and (q.on is not None or q.at is not None)]
    stresses = [q for q in placed if q.dimension == STRESS]
    lengths = [q for q in placed if q.dimension == LENGTH]
    return _of_stresses(equations, solution, stresses) | _of_displacements(equations.body, solution, lengths)


def _of_stresses(
    equations: Equations, solution: Solution, quantities: Sequence[QuantityOfInterest]
) -> dict[str, LayerError]:
    """Return the errors of stresses; of unknown size where tractions of the loads are not known; collective."""
    if not quantities:
        return {}
    if (tractions := face_tractions(equations, solution)) is None:
        return {q.name: LayerError(0.0, "of unknown size: growth, active stress or prestrain") for q in quantities}
    body, errors = equations.body, {}
    nodes = source_node_values(body, solution.mesh_nodes)
    for quantity in quantities:
        places = _places(body, nodes, quantity)
        missing = on_root(body.mesh.comm, partial(_missing, tractions, places))
        size = float(missing.mean() if quantity.reduce in ("mean", "rms") else missing.max())
        errors[quantity.name] = LayerError(size, "by the tractions on its faces")
    return errors


def _missing(tractions: FaceTractions, places: Floats) -> Floats:
    """Return the tractions (2, n) in Pa that the stress lacks on both faces, at the nodes nearest to some places."""
    faces = zip(tractions.points, tractions.missing, strict=True)
    return np.stack([missing[_nearest(points, places)[1]] for points, missing in faces])


def _of_displacements(
    body: Body, solution: Solution, quantities: Sequence[QuantityOfInterest]
) -> dict[str, LayerError]:
    """Return the errors of displacements and positions; none without a clamp; collective."""
    nodes = source_node_values(body, solution.mesh_nodes)
    clamped = [s.region for s in solution.job.supports if len(s.held) == 3 and not s.hinge]
    clamps = _gathered(body, [nodes[owned_nodes(body, name)] for name in clamped])
    if not len(clamps):
        return {}
    moved, errors = np.linalg.norm(source_node_values(body, solution.u), axis=1), {}
    for quantity in quantities:
        places = _places(body, nodes, quantity)
        share = on_root(body.mesh.comm, partial(_clamp_share, body.source, places, clamps))
        size = CLAMPED * share * _largest_there(body, nodes, moved, quantity)
        errors[quantity.name] = LayerError(size, f"clamped at t/d = {share:.2g}")
    return errors


def _gathered(body: Body, parts: Sequence[Floats]) -> Floats:
    """Return points of all ranks, the same on each; collective."""
    return np.concatenate([p for rank in body.mesh.comm.allgather(list(parts)) for p in rank] or [np.zeros((0, 3))])


def _places(body: Body, nodes: Floats, quantity: QuantityOfInterest) -> Floats:
    """Return points (m) of a quantity in the given body: its point, or the nodes of its region; collective."""
    if quantity.on is None:
        return np.array([quantity.at])
    return _gathered(body, [nodes[owned_nodes(body, quantity.on)]])


def _largest_there(body: Body, nodes: Floats, moved: Floats, quantity: QuantityOfInterest) -> float:
    """Return the largest displacement (m) at the nodes of a region, or at the node next to a point; collective."""
    if quantity.on is not None:
        largest = float(moved[owned_nodes(body, quantity.on)].max(initial=0.0))
        return float(max(body.mesh.comm.allgather(largest)))
    distances = np.linalg.norm(nodes - np.array(quantity.at), axis=1)
    best = (float(distances.min()), float(moved[distances.argmin()])) if len(nodes) else (np.inf, 0.0)
    return float(min(body.mesh.comm.allgather(best))[1])


def _clamp_share(source: MeshSource, places: Floats, clamps: Floats) -> float:
    """Return the largest thickness over the mean distance of some places from the nodes of clamps, at most 1."""
    assert source.midsurface is not None
    levels = source.points.reshape(-1, len(source.midsurface.points), 3)
    thickness = float(np.linalg.norm(levels[-1] - levels[0], axis=1).max(initial=0.0))
    distance = float(_nearest(clamps, places)[0].mean())
    return min(thickness / distance, 1.0) if distance > 0 else 1.0


def _nearest(points: Floats, places: Floats) -> tuple[Floats, Ints]:
    """Return distances (n,) of places from their nearest points, and these points' numbers."""
    if len(points) * len(places) > _DIRECT:
        from scipy.spatial import cKDTree

        found = cKDTree(points).query(places)
        return np.asarray(found[0]), np.asarray(found[1])
    distances, numbers = np.empty(len(places)), np.empty(len(places), dtype=np.int64)
    for first in range(0, len(places), step := max(1, _CHUNK // len(points))):
        part = slice(first, first + step)
        between = np.linalg.norm(places[part, None] - points[None], axis=2)
        numbers[part] = between.argmin(axis=1)
        distances[part] = between.min(axis=1)
    return distances, numbers


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
