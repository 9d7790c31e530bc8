"""How far shapes are from each other: the recovered one from the expected one, a round trip's end from its beginning.

Every distance is a dict of ``max`` and ``rms`` over the geometry nodes (m), and ``relative``, the first divided by the
diagonal of the body's bounding box.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np

from hpcinv.errors import MeshError
from hpcinv.mesh import Body, gather_nodes, read_source
from hpcinv.runtime import on_root
from hpcinv.sections import MeshSpec

if TYPE_CHECKING:
    from hpcinv.job import Job
    from hpcinv.mesh.source import Floats
    from hpcinv.result import Leg


def read_expected(job: Job, body: Body) -> Floats | None:
    """Nodes (n, 3) m of the job's expected shape on rank 0, in the order of the body's; ``None`` if it names none.

    Collective.

    Raises:
        MeshError: on every rank, if it cannot be read or is not the body's mesh at other coordinates.
    """
    expected = job.expected_shape
    if expected is None:
        return None
    # Straight or curved as the body is, whatever the file is; it was checked to exist when the job was read.
    spec = MeshSpec.model_construct(**(dict(expected) | {"geometry_degree": body.source.degree}))
    points: list[Floats] = []

    def on_rank_0() -> None:
        path = job.resolve(expected.file)
        source, given = read_source(spec, path), body.source
        advice = f"expected_shape needs the nodes and cells of {given.path}, in the same order."
        if len(source.points) != len(given.points):
            counts = f"{len(source.points)} nodes, but the job's mesh has {len(given.points)}"
            raise MeshError(f"{path}: has {counts}", advice)
        if not np.array_equal(source.cells, given.cells):
            raise MeshError(f"{path}: its cells join other nodes than those of the job's mesh", advice)
        points.append(source.points)

    on_root(body.mesh.comm, on_rank_0)
    return points[0] if points else None


def distance(body: Body, leg: Leg, expected: Floats | None) -> dict[str, float]:
    """Distance of the shape that was looked for from ``expected``, which rank 0 knows; collective."""
    found = gather_nodes(body, leg.other_nodes)

    def measure() -> dict[str, float]:
        assert found is not None
        assert expected is not None
        return _size(found - expected, expected)

    return on_root(body.mesh.comm, measure)


def closure(there: Leg, back: Leg) -> dict[str, float]:
    """Difference ``u₁ - u₀`` of the displacements ``u = x - X`` of the two legs of a round trip; collective."""
    mesh = there.displacement.function_space.mesh
    owned = slice(mesh.geometry.index_map().size_local)
    parts = mesh.comm.allgather(((back.u - there.u)[owned], there.mesh_nodes[owned]))
    return _size(*map(np.concatenate, zip(*parts, strict=True)))


def _size(difference: Floats, nodes: Floats) -> dict[str, float]:
    lengths = np.linalg.norm(difference, axis=1)
    largest, diagonal = float(lengths.max()), float(np.linalg.norm(np.ptp(nodes, axis=0)))
    return {"max": largest, "rms": float(np.sqrt(np.mean(lengths**2))), "relative": largest / diagonal}
