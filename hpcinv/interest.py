"""Quantities of interest: formulas of position and displacement at a point, or reduced over the nodes of a region."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
import numpy.typing as npt
from dolfinx import geometry, la
from dolfinx.mesh import entities_to_geometry

from hpcinv.errors import JobError, MeshError
from hpcinv.mesh.regions import find
from hpcinv.placement import placed
from hpcinv.runtime import MPI

if TYPE_CHECKING:
    from hpcinv.mesh import Body
    from hpcinv.mesh.source import Floats
    from hpcinv.result import Leg
    from hpcinv.sections import QuantityOfInterest

# A point is taken to be in a cell up to this far outside, as a share of the cell: points on a truly curved surface lie
# outside of straight cells, by about h/6R of them where the radius is R, and coarse cells are as large as R.
_MARGIN = 0.2


def check_points(quantities: Iterable[QuantityOfInterest], body: Body) -> None:
    """Check before the solve that the quantities' points lie in the body and that it has their regions; collective.

    Raises:
        MeshError: on every rank, with all that is wrong.
    """
    problems = []
    for quantity in quantities:
        if quantity.on is not None:
            find(body.regions, quantity.on, body.source)
        elif _cell_at(body, np.array(quantity.at) / body.length_scale) is None:
            problems.append(f"quantities: {quantity.name}: the point ({_triple(quantity.at)}) m is outside of the body")
    if problems:
        low, high = _box(body)
        raise MeshError(
            "\n".join(f"{body.source.path}: {p}" for p in problems),
            f"It extends from ({_triple(low)}) to ({_triple(high)}) m; points are in metres unless they have a unit.",
        )


def evaluate(quantities: Iterable[QuantityOfInterest], body: Body, leg: Leg) -> dict[str, float | list[float]]:
    """Values of the quantities in SI by name, the displacement as a list of 3; collective.

    Raises:
        MeshError: on every rank, if a point is outside of the body, or there is no such region.
        JobError: on every rank, if a formula has no finite value.
    """
    quantities = tuple(quantities)
    with placed(body.mesh, leg.mesh_nodes / body.length_scale):
        check_points(quantities, body)
        return {q.name: (_on_region if q.at is None else _at_point)(q, body, leg) for q in quantities}


def _at_point(quantity: QuantityOfInterest, body: Body, leg: Leg) -> float | list[float]:
    at = np.array(quantity.at) / body.length_scale
    comm, found = body.mesh.comm, _cell_at(body, at)
    assert found is not None  # check_points has been asked
    rank, cell = found
    mine = leg.displacement.eval(at, np.array([cell], dtype=np.int32)) if comm.rank == rank else None
    u: Floats = comm.bcast(mine, root=rank)
    if quantity.is_displacement:
        return [float(c) for c in u]
    here = at * body.length_scale
    X, x = (here, here + u) if leg.direction == "forward" else (here - u, here)
    return float(_values(quantity, body, X[None], x[None], u[None])[0])


def _on_region(quantity: QuantityOfInterest, body: Body, leg: Leg) -> float:
    assert quantity.on is not None
    assert quantity.reduce is not None
    nodes = _owned_nodes(body, quantity.on)
    values = _values(quantity, body, leg.reference_nodes[nodes], leg.current_nodes[nodes], leg.u[nodes])
    return _REDUCTIONS[quantity.reduce](body.mesh.comm, values)


def _values(quantity: QuantityOfInterest, body: Body, X: Floats, x: Floats, u: Floats) -> Floats:
    """The quantity's formula at points with reference and current positions and displacements (n, 3) m; collective."""
    names = dict(zip("XYZ", X.T, strict=True)) | dict(zip("xyz", x.T, strict=True))
    names |= dict(zip(("ux", "uy", "uz"), u.T, strict=True))
    values: Floats = quantity.of.evaluate(**names)
    comm = body.mesh.comm
    if bad := comm.allreduce(int(np.count_nonzero(~np.isfinite(values)))):
        what = f"quantities: {quantity.name}: '{quantity.of}' has no finite value"
        where = f"({_triple(quantity.at)}) m" if quantity.at else f"{bad} of the nodes of '{quantity.on}'"
        raise JobError([f"{what} at {where}; look for divisions by zero, and roots and logarithms of negative values"])
    return values


def _mean(comm: MPI.Intracomm, values: Floats) -> float:
    total, count = comm.allreduce(float(values.sum())), comm.allreduce(len(values))
    return float(total / count)


def _max(comm: MPI.Intracomm, values: Floats) -> float:
    return float(comm.allreduce(float(values.max(initial=-np.inf)), op=MPI.MAX))


_REDUCTIONS: Mapping[str, Callable[[MPI.Intracomm, Floats], float]] = {
    "max": _max,
    "min": lambda comm, values: -_max(comm, -values),
    "mean": _mean,
    "max_abs": lambda comm, values: _max(comm, np.abs(values)),
    "rms": lambda comm, values: _mean(comm, values**2) ** 0.5,
}


def _owned_nodes(body: Body, name: str) -> npt.NDArray[np.int64]:
    """Geometry nodes of a region's facets and cells, each on the one rank that owns it."""
    region, nodes = find(body.regions, name, body.source), body.mesh.geometry.index_map()
    marks = la.vector(nodes, 1)
    for dim, entities in ((2, region.facets), (3, region.cells)):
        if len(entities):
            body.mesh.topology.create_connectivity(dim, 3)
            marks.array[entities_to_geometry(body.mesh, dim, entities)] = 1.0
    # The owner of a node on the region's edge may have none of the region's facets itself.
    marks.scatter_reverse(la.InsertMode.add)
    return np.flatnonzero(marks.array[: nodes.size_local])


def _cell_at(body: Body, point: Floats) -> tuple[int, int] | None:
    """Rank and local cell that hold a point of the scaled mesh, the same on all ranks; collective."""
    mesh = body.mesh
    x, dofmap = mesh.geometry.x, mesh.geometry.dofmaps[0]
    owned = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
    padding = _MARGIN * float(mesh.h(3, owned).max(initial=0.0))
    tree = geometry.bb_tree(mesh, 3, padding=padding, entities=owned)
    candidates = geometry.compute_collisions_points(tree, point).array
    excess = [_outside(mesh.geometry.cmaps[0], body.source.kind, point, x[dofmap[cell]]) for cell in candidates]
    nearest = int(np.argmin(excess)) if excess else -1
    mine = (excess[nearest], mesh.comm.rank, int(candidates[nearest])) if excess else (np.inf, mesh.comm.rank, -1)
    least, rank, cell = min(mesh.comm.allgather(mine))
    return (rank, cell) if least <= _MARGIN else None


def _outside(cmap: Any, kind: str, point: Floats, nodes: Floats) -> float:
    """How far a point is outside of a cell in reference coordinates; at most 0 inside."""
    try:
        xi = cmap.pull_back(point[None], nodes)[0]
    except RuntimeError:  # Newton's method fails where the point is far from a curved cell
        return np.inf
    beyond = xi.sum() - 1 if kind == "tetrahedron" else xi.max() - 1
    return float(max(-xi.min(), beyond))


def _box(body: Body) -> tuple[Floats, Floats]:
    points = body.mesh.geometry.x * body.length_scale
    low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    body.mesh.comm.Allreduce(MPI.IN_PLACE, low, MPI.MIN)
    body.mesh.comm.Allreduce(MPI.IN_PLACE, high, MPI.MAX)
    return low, high


def _triple(point: Any) -> str:
    return ", ".join(f"{c:g}" for c in point)
