"""Location of points in a distributed mesh: rank, cell, and reference coordinates."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import geometry

from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh.body import Body
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.source import Floats

type Point = tuple[float, float, float]

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


def locate(body: Body, points: Iterable[Point]) -> dict[Point, PointLocation | None]:
    """Return where points (m) of the body are, the same on all ranks; ``None`` outside of it; collective."""
    distinct, comm = list(dict.fromkeys(points)), body.mesh.comm
    nearest = [(np.inf, comm.rank, -1, np.zeros(3)) for _ in distinct]
    for number, cells in enumerate(_cells_near(body, distinct)):
        for cell, distance, xi in cells:
            if distance < nearest[number][0]:
                nearest[number] = (distance, comm.rank, cell, xi)
    places = dict[Point, PointLocation | None]()
    for point, *on_ranks in zip(distinct, *comm.allgather(nearest), strict=True):
        distance, rank, cell, xi = min(on_ranks)  # ranks differ, so that coordinates are not compared
        places[point] = PointLocation(rank, cell, xi) if distance <= _MARGIN else None
    return places


def cells_at(body: Body, points: Iterable[Point]) -> list[int]:
    """Return the owned cells that contain one of the points (m), several of them if it is on their border."""
    near = _cells_near(body, list(points))
    return [cell for cells in near for cell, distance, _ in cells if distance == 0.0]


def _cells_near(body: Body, points: Sequence[Point]) -> Iterator[Iterator[tuple[int, float, Floats]]]:
    """Yield for each point owned cells near it, its distance outside of each, relative to its size, and coordinates."""
    if not points:
        return
    mesh, scaled = body.mesh, np.array(points) / body.length_scale
    owned = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
    padding = _MARGIN * float(mesh.h(3, owned).max(initial=0.0))
    tree = geometry.bb_tree(mesh, 3, padding=padding, entities=owned)  # takes longer than the search of many points
    candidates = geometry.compute_collisions_points(tree, scaled)
    for number, point in enumerate(scaled):
        yield _coordinates(body, point, np.sort(candidates.links(number)))


def _coordinates(body: Body, point: Floats, cells: LocalIndices) -> Iterator[tuple[int, float, Floats]]:
    """Yield cells, how far a scaled point is outside of each, and its reference coordinates there, if it has such."""
    cmap, x, nodes = body.mesh.geometry.cmaps[0], body.mesh.geometry.x, body.mesh.geometry.dofmaps[0]
    for cell in cells:
        xi = _pulled_back(cmap, point, x[nodes[cell]])
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
