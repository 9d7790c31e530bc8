"""Location of points in a distributed mesh: rank, cell, and reference coordinates."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import geometry

from hpcinv.mesh.body import Body
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.source import Floats

# Distance outside a cell, relative to its size, up to which a point still counts as inside: points on a curved surface
# lie outside straight cells, by about h/6R of their size where the radius is R, and coarse cells are as large as R.
_MARGIN = 0.2
_DIGITS = (
    9  # of that distance, so that a point on the border of cells is in the same one of them wherever the mesh lies
)


@dataclass(frozen=True)
class PointLocation:
    """A rank, one of its cells, and reference coordinates (3,) in the cell."""

    rank: int
    cell: int
    xi: Floats


def locate(body: Body, point: Floats) -> PointLocation | None:
    """Location of a point (3,) m of the body, the same on all ranks; ``None`` if it is outside; collective."""
    mesh = body.mesh
    nearest: tuple[float, int, int] = (np.inf, mesh.comm.rank, -1)
    coordinates = np.zeros(3)
    for cell, distance, xi in _cells_near(body, point):
        if distance < nearest[0]:
            nearest, coordinates = (distance, mesh.comm.rank, cell), xi
    least, rank, cell = min(mesh.comm.allgather(nearest))
    return PointLocation(rank, cell, mesh.comm.bcast(coordinates, root=rank)) if least <= _MARGIN else None


def cells_at(body: Body, point: Floats) -> list[int]:
    """Return the owned cells that contain a point (3,) m, several of them if it is on their border."""
    return [cell for cell, distance, _ in _cells_near(body, point) if distance == 0.0]


def _cells_near(body: Body, point: Floats) -> Iterator[tuple[int, float, Floats]]:
    """Yield owned cells near a point, its distance outside of each, relative to its size, and its coordinates there."""
    mesh, scaled = body.mesh, point / body.length_scale
    owned = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
    padding = _MARGIN * float(mesh.h(3, owned).max(initial=0.0))
    tree = geometry.bb_tree(mesh, 3, padding=padding, entities=owned)
    for cell in np.sort(geometry.compute_collisions_points(tree, scaled).array):
        xi = _pulled_back(mesh.geometry.cmaps[0], scaled, mesh.geometry.x[mesh.geometry.dofmaps[0][cell]])
        if xi is not None:
            yield int(cell), round(max(_distance_outside(body.source.kind, xi), 0.0), _DIGITS), xi


def position(body: Body, place: PointLocation, nodes: Floats) -> Floats:
    """Return the position (3,) of a material point of the body with its geometry nodes at ``nodes``; collective."""
    point = None
    if body.mesh.comm.rank == place.rank:
        shapes = scalar_element(body.source.kind, body.degree).tabulate(0, place.xi[None])[0, 0, :, 0]
        point = shapes @ nodes[body.mesh.geometry.dofmaps[0][place.cell]]
    return np.asarray(body.mesh.comm.bcast(point, root=place.rank))


def _pulled_back(cmap: Any, point: Floats, nodes: Floats) -> Floats | None:
    try:
        return np.asarray(cmap.pull_back(point[None], nodes)[0])
    except RuntimeError:  # Newton's method fails where the point is far from a curved cell
        return None


def _distance_outside(kind: str, xi: Floats) -> float:
    """Distance of a point from the reference cell; at most 0 inside."""
    upper = xi.sum() - 1 if kind == "tetrahedron" else xi.max() - 1
    return float(max(-xi.min(), upper))
