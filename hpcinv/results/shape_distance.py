"""Distances between shapes: recovered and expected, beginning and end of a round trip.

Every distance is a dict of ``max`` and ``rms`` over the geometry nodes (m), and ``relative``, the first divided by the
diagonal of the body's bounding box. From a surface they are of points of the recovered surface, and ``max`` is
the largest distance of either surface from the other one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from dolfinx.mesh import Geometry

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import MeshError
from hpcinv.job.job import Job
from hpcinv.job.mesh_file import ExpectedShape
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh import Body
from hpcinv.mesh.body import read_anywhere, source_node_values, source_values
from hpcinv.mesh.distributed.rows import Rows
from hpcinv.mesh.extent import diagonal
from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.mesh.surface import gather_surface
from hpcinv.on_demand import on_demand
from hpcinv.results.solution import Solution

if TYPE_CHECKING:
    import pyvista

_SIDES = 4  # parts of each side of a curved facet


type Expected = Callable[[Body, Solution], dict[str, float]]
"""distance of a recovered shape from the one that a run should find; collective"""


def read_expected(job: Job, body: Body) -> Expected | None:
    """Read the job's expected shape; ``None`` if it names none; collective.

    Raises:
        MeshError: on every rank, if it cannot be read or is not the body's mesh at other coordinates.
        SystemPartMissing: on every rank, if the packages for images are not installed.
    """
    expected = job.expected_shape
    if expected is None:
        return None
    if not expected.has_nodes:
        return partial(_surface_distance, _read_surface(job, expected, body.mesh.comm), expected.align)
    # Straight or curved as the body is, whatever the file is; it was checked to exist when the job was read.
    stated = expected.model_fields_set & MeshSpec.model_fields.keys()
    values = {name: getattr(expected, name) for name in stated}
    spec = MeshSpec.model_construct(**(values | {"labels": {}, "geometry_degree": body.source.degree}))
    nodes = source_values(body, read_same_cells(spec, job, body, "expected_shape").points)
    return partial(distance, expected=nodes)


def _read_surface(job: Job, expected: ExpectedShape, comm: MPI.Intracomm) -> pyvista.PolyData | None:
    surfaces: list[pyvista.PolyData] = []

    def read_on_root() -> None:
        path = job.resolve(expected.file)
        if expected.is_image:
            surfaces.append(on_demand("surface in an image")(path, expected.labels, expected.metres))
        else:
            surface = on_demand("surface in a file")(path)
            surface.points = np.asarray(surface.points, dtype=np.float64) * expected.unit
            surfaces.append(surface)

    on_root(comm, read_on_root)
    return surfaces[0] if surfaces else None


def read_same_cells(spec: MeshSpec, job: Job, body: Body, name: str) -> MeshSource:
    """Read a mesh with the nodes and cells of a body's; collective.

    Args:
        name: of the mesh, for messages.

    Raises:
        MeshError: on every rank, if it cannot be read or is not the body's mesh at other coordinates.
    """
    source, given = read_anywhere(spec, job.resolve, body.mesh.comm), body.source
    advice = f"{name} needs the nodes and cells of {given.path}, in the same order."
    nodes, nodes_given = (Rows.distributed(body.mesh.comm, len(mesh.points)).total for mesh in (source, given))
    if nodes != nodes_given:
        counts = f"{nodes} nodes, but the job's mesh has {nodes_given}"
        raise MeshError(f"{source.path}: has {counts}", advice)
    if not body.mesh.comm.allreduce(np.array_equal(source.cells, given.cells), op=MPI.LAND):
        raise MeshError(f"{source.path}: its cells join other nodes than the job's mesh", advice)
    return source


def differences(body: Body, solutions: Sequence[Solution], expected: Expected | None) -> dict[str, dict[str, float]]:
    """Return the distance of the first solution's shape from the ``expected`` one, and a round trip's closure error."""
    distances = {}
    if expected is not None:
        distances["expected_shape"] = expected(body, solutions[0])
    if len(solutions) == 2 and not solutions[0].state:
        distances["round_trip"] = closure(*solutions)
    return distances


def distance(body: Body, solution: Solution, expected: Floats) -> dict[str, float]:
    """Return the distance of the computed shape from ``expected`` local nodes (n, 3) m of the source; collective."""
    nodes = source_node_values(body, solution.other_nodes)
    return _size(body.mesh.comm, body.source_geometry, nodes - expected, expected)


def _surface_distance(
    surface: pyvista.PolyData | None, align: bool, body: Body, solution: Solution
) -> dict[str, float]:
    """Return the distance of the recovered surface from a closed one (m), which is on rank 0; collective."""
    comm, recovered = body.mesh.comm, gather_surface(body, solution.other_nodes)

    def compare_on_root() -> dict[str, float]:
        import pyvista  # takes a second

        assert recovered is not None
        assert surface is not None
        cut = recovered.cut(1 if recovered.degree == 1 else _SIDES, np.arange(len(recovered.nodes)))
        polygons = pyvista.PolyData.from_regular_faces(cut.points, cut.corners)
        compared = on_demand("comparison of surfaces")(polygons, surface, (polygons, surface) if align else None)
        largest = max(compared.first.largest, compared.second.largest)
        return {
            "max": largest,
            "rms": compared.first.rms,
            "relative": largest / float(np.linalg.norm(np.ptp(cut.points, axis=0))),
            "mean": compared.first.mean,
            "quantile_95": compared.first.quantile_95,
            "dice": compared.dice,
        }

    return on_root(comm, compare_on_root)


def closure(first: Solution, second: Solution) -> dict[str, float]:
    """Return the difference ``u₁ - u₀`` of the displacements ``u = x - X`` of a round trip's solutions; collective."""
    mesh = first.displacement.function_space.mesh
    return _size(mesh.comm, mesh.geometry, second.u - first.u, first.mesh_nodes)


def _size(comm: MPI.Intracomm, geometry: Geometry, difference: Floats, nodes: Floats) -> dict[str, float]:
    """Norms of differences over the owned nodes of all ranks."""
    owned = geometry.index_map()
    squares = (difference[: owned.size_local] ** 2).sum(axis=1)
    largest = float(comm.allreduce(float(squares.max(initial=0.0)), op=MPI.MAX)) ** 0.5
    mean = float(comm.allreduce(float(squares.sum()))) / owned.size_global
    return {"max": largest, "rms": mean**0.5, "relative": largest / diagonal(comm, nodes)}
