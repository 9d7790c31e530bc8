"""Gathering of a body's interior from all ranks; the cells of a large body are joined to fewer ones."""

from collections.abc import Collection, Sequence
from functools import cache
from typing import Any

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.base.quantity.stress_measures import COMPONENTS
from hpcinv.mesh import Body
from hpcinv.mesh.boundary_shells import SIDES, facing
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.topology import unique_rows
from hpcinv.output.surfaces.gathering import of_states
from hpcinv.output.surfaces.interior import Interior, InteriorResult
from hpcinv.results.cell_fields import cell_fields
from hpcinv.results.solution import Solution

MOST = 60_000
"""largest number of tetrahedra of a body that are kept as they are; if it is raised, pages and files are larger"""
_STATES = 3  # of that many tetrahedra; more states have fewer
_TETRAHEDRA_OF_A_CUBE = 6


def interior_of(
    body: Body, solutions: Sequence[Solution] = (), labels: Collection[str] = (), most: int = MOST
) -> Interior | None:
    """Gather the interior of a body and of what was found of it on rank 0, ``None`` on others; collective.

    Of a body with more cells, nodes in one cube of a grid become the one of them that is nearest to its middle, except
    that nodes inside, and on parts of the boundary that face another way, stay apart.

    Args:
        solutions: the first, and one of each further state of the body, as `gathering.boundary_of` takes them.
        labels: regions of cells that a job defines and has materials for; groups of the mesh are always kept.
        most: about the largest number of tetrahedra.
    """
    solutions = of_states(solutions)
    most = most * _STATES // max(_STATES, len(solutions))
    mesh, comm, kind = body.mesh, body.mesh.comm, body.source.kind
    owned = mesh.topology.index_map(3).size_local
    cell_count = mesh.topology.index_map(3).size_global
    pattern = _tetrahedra(kind, body.degree)
    if cell_count * len(pattern) > most:
        pattern = _tetrahedra(kind, 1)
    is_joined = cell_count * len(pattern) > most
    dofmap = mesh.geometry.dofmaps[0][:owned]
    corners = dofmap[:, pattern].reshape(-1, 4).astype(np.int64)
    cells = np.repeat(np.arange(owned), len(pattern))
    middles = scalar_element(kind, body.degree).points[pattern].mean(axis=1)
    nodes = body.given_nodes
    numbers = mesh.geometry.index_map().local_to_global(np.arange(len(nodes), dtype=np.int32)).astype(np.int64)
    keys = _clusters(body, corners, most) if is_joined else numbers
    distance = _from_middle(body, keys, nodes) if is_joined else np.zeros(len(nodes))

    chosen = _distinct(keys[corners])
    used = np.unique(corners[chosen])
    places = middles[chosen % len(pattern)]
    regions = _regions_of_cells(body, labels)
    marks = np.stack([np.isin(cells[chosen], members) for members in regions.values()] or [chosen < 0], axis=1)
    positions = [nodes, *(part for solution in solutions for part in (solution.mesh_nodes, solution.other_nodes))]
    parts = [_values(body, solution, cells[chosen], places) for solution in solutions]
    gathered = comm.gather(
        (
            keys[corners[chosen]],
            marks,
            np.concatenate([np.zeros((len(chosen), 0)), *parts], axis=1),
            keys[used],
            distance[used],
            numbers[used],
            np.concatenate([part[used] for part in positions], axis=1),
        )
    )
    return None if gathered is None else _joined(gathered, list(regions), len(solutions), is_joined=is_joined)


def _regions_of_cells(body: Body, labels: Collection[str]) -> dict[str, LocalIndices]:
    """Return the cells of groups of the mesh, and of the regions of a job with some names."""
    return {
        name: region.cells
        for name, region in body.regions.items()
        if region.cell_count and (region.origin == "physical" or name in labels)
    }


def _joined(gathered: Sequence[tuple[Any, ...]], names: Sequence[str], count: int, *, is_joined: bool) -> Interior:
    """Return the interior from what each rank sent, with so many solutions."""
    corner_keys, marks, values, keys, distance, numbers, places = map(np.concatenate, zip(*gathered, strict=True))
    order = np.lexsort((numbers, distance, keys))
    distinct, row = np.unique(keys[order], return_index=True)
    places = places[order[row]]
    tetrahedra = np.searchsorted(distinct, corner_keys)
    kept = _distinct(tetrahedra)
    points, *pairs = np.split(places, 1 + 2 * count, axis=1)
    columns = np.split(values[kept], max(1, count), axis=1)
    results = tuple(
        InteriorResult(pairs[2 * i], pairs[2 * i + 1], columns[i][:, :6], columns[i][:, 6], columns[i][:, 7:])
        for i in range(count)
    )
    regions = {name: marks[kept, k] for k, name in enumerate(names)}
    return Interior(points, tetrahedra[kept], regions, results, is_joined)


def _distinct(corners: Ints) -> Ints:
    """Return the tetrahedra, in order, with four corners that differ, each set of corners once."""
    sets = np.sort(corners, axis=1)
    whole = np.flatnonzero((np.diff(sets, axis=1) > 0).all(axis=1))
    _, place = unique_rows(sets[whole])
    return np.sort(whole[np.unique(place, return_index=True)[1]])


def _values(body: Body, solution: Solution, cells: Ints, places: Floats) -> Floats:
    """Stress, J and principal stretches in local cells, of a shell at places in them, (cells, 10)."""
    fields = cell_fields(body, solution, cells, places)
    stress = fields.stress.reshape(-1, 3, 3)
    parts = [stress[:, i, j][:, None] for i, j in COMPONENTS.values()]
    return np.concatenate([*parts, fields.J[:, None], fields.stretches], axis=1)


def _clusters(body: Body, corners: Ints, most: int) -> Ints:
    """Number of the cluster of each local node; collective."""
    comm, nodes = body.mesh.comm, body.given_nodes
    low, side = _grid(body, corners, most)
    place = np.floor((nodes - low) / side).astype(np.int64)
    most_place = comm.allreduce(int(place.max(initial=0)), op=MPI.MAX) + 1
    return np.asarray(((place[:, 0] * most_place + place[:, 1]) * most_place + place[:, 2]) * SIDES + facing(body.mesh))


def _grid(body: Body, corners: Ints, most: int) -> tuple[Floats, float]:
    """Corner of the body and side of the cubes in whose number it has about ``most`` tetrahedra; collective."""
    comm, nodes = body.mesh.comm, body.given_nodes
    a, b, c, d = (nodes[corners[:, k]] for k in range(4))
    volume = comm.allreduce(float(np.abs(np.einsum("ni,ni->n", np.cross(b - a, c - a), d - a)).sum()) / 6)
    low = np.empty(3)
    comm.Allreduce(nodes.min(axis=0, initial=np.inf), low, op=MPI.MIN)
    return low, (volume * _TETRAHEDRA_OF_A_CUBE / most) ** (1 / 3)


def _from_middle(body: Body, keys: Ints, nodes: Floats) -> Floats:
    """Distance of each node from the middle of the local nodes of its cluster."""
    _, cluster = np.unique(keys, return_inverse=True)
    count = np.bincount(cluster)
    middle = np.stack([np.bincount(cluster, nodes[:, i]) / count for i in range(3)], axis=1)
    return np.asarray(np.linalg.norm(nodes - middle[cluster], axis=1))


@cache
def _tetrahedra(kind: str, degree: int) -> Ints:
    """Nodes of a reference cell, (k, 4), of the tetrahedra into which its nodes divide it."""
    lattice = np.rint(scalar_element(kind, degree).points * degree).astype(int)
    number = {tuple(place): k for k, place in enumerate(lattice.tolist())}
    steps = np.array([[[0, 0, 0], *np.cumsum(np.eye(3, dtype=int)[list(way)], axis=0)] for way in _WAYS])
    cubes = np.array([[i, j, k] for i in range(degree) for j in range(degree) for k in range(degree)])
    parts = (cubes[:, None, None] + steps).reshape(-1, 4, 3)
    if kind == "tetrahedron":
        # Kuhn's division of the cube contains the one of the simplex 1 >= a >= b >= c >= 0.
        parts = parts[(np.diff(parts, axis=2) <= 0).all(axis=(1, 2))]
        parts = np.stack([parts[..., 0] - parts[..., 1], parts[..., 1] - parts[..., 2], parts[..., 2]], axis=-1)
    return np.array([[number[tuple(place)] for place in part] for part in parts.tolist()], dtype=np.int64)


_WAYS = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))
