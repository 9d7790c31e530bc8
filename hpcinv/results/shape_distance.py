"""Distances between shapes: recovered and expected, beginning and end of a round trip.

Every distance is a dict of ``max`` and ``rms`` over the geometry nodes (m), and ``relative``, the first divided by the
diagonal of the body's bounding box.
"""

from collections.abc import Sequence

import numpy as np

from hpcinv.errors import MeshError
from hpcinv.job.job import Job
from hpcinv.job.sections import MeshSpec
from hpcinv.mesh import Body, at_local_nodes
from hpcinv.mesh.body import read_anywhere
from hpcinv.mesh.bounding_box import diagonal
from hpcinv.mesh.distributed.rows import Rows
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.parallel.runtime import MPI
from hpcinv.results.solution import Solution


def read_expected(job: Job, body: Body) -> Floats | None:
    """Read the local geometry nodes (n, 3) m of the job's expected shape; ``None`` if it names none; collective.

    Raises:
        MeshError: on every rank, if it cannot be read or is not the body's mesh at other coordinates.
    """
    expected = job.expected_shape
    if expected is None:
        return None
    # Straight or curved as the body is, whatever the file is; it was checked to exist when the job was read.
    spec = MeshSpec.model_construct(**(dict(expected) | {"geometry_degree": body.source.degree}))
    return at_local_nodes(body, read_same_cells(spec, job, body, "expected_shape").points)


def read_same_cells(spec: MeshSpec, job: Job, body: Body, name: str) -> MeshSource:
    """Read a mesh with the nodes and cells of a body's; collective.

    Args:
        name: of the mesh, for messages.

    Raises:
        MeshError: on every rank, if it cannot be read or is not the body's mesh at other coordinates.
    """
    source, given = read_anywhere(spec, job.resolve, body.mesh.comm), body.source
    advice = f"{name} needs the nodes and cells of {given.path}, in the same order."
    nodes, nodes_given = (Rows.of(body.mesh.comm, len(mesh.points)).total for mesh in (source, given))
    if nodes != nodes_given:
        counts = f"{nodes} nodes, but the job's mesh has {nodes_given}"
        raise MeshError(f"{source.path}: has {counts}", advice)
    if not body.mesh.comm.allreduce(np.array_equal(source.cells, given.cells), op=MPI.LAND):
        raise MeshError(f"{source.path}: its cells join other nodes than those of the job's mesh", advice)
    return source


def differences(body: Body, solutions: Sequence[Solution], expected: Floats | None) -> dict[str, dict[str, float]]:
    """Return the distance of the first solution's shape from ``expected`` nodes, and the round trip's closure error."""
    found = {}
    if expected is not None:
        found["expected_shape"] = distance(body, solutions[0], expected)
    if len(solutions) == 2 and not solutions[0].state:
        found["round_trip"] = closure(*solutions)
    return found


def distance(body: Body, solution: Solution, expected: Floats) -> dict[str, float]:
    """Return the distance of the computed shape from ``expected`` local nodes (n, 3) m; collective."""
    return _size(body.mesh, solution.other_nodes - expected, expected)


def closure(there: Solution, back: Solution) -> dict[str, float]:
    """Return the difference ``u₁ - u₀`` of the displacements ``u = x - X`` of a round trip's solutions; collective."""
    return _size(there.displacement.function_space.mesh, back.u - there.u, there.mesh_nodes)


def _size(mesh: Mesh, difference: Floats, nodes: Floats) -> dict[str, float]:
    """Norms of differences over the owned nodes of all ranks."""
    comm, owned = mesh.comm, mesh.geometry.index_map()
    squares = (difference[: owned.size_local] ** 2).sum(axis=1)
    largest = float(comm.allreduce(float(squares.max(initial=0.0)), op=MPI.MAX)) ** 0.5
    mean = float(comm.allreduce(float(squares.sum()))) / owned.size_global
    return {"max": largest, "rms": mean**0.5, "relative": largest / diagonal(comm, nodes)}
