"""Blocks of unit cubes without some of them."""

from __future__ import annotations

from collections.abc import Collection
from itertools import permutations
from pathlib import Path

import numpy as np

from hpcinv.mesh.source import MeshSource

type Cube = tuple[int, int, int]


def hollow_block(holes: Collection[Cube], kind: str = "hexahedron", divisions: Cube = (4, 4, 3)) -> MeshSource:
    """A block of unit cubes without those at ``holes``, whole or cut into six tetrahedra."""
    cubes = [cube for cube in np.ndindex(divisions) if cube not in holes]
    corners = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)])
    points, cells = np.unique((np.array(cubes)[:, None] + corners).reshape(-1, 3), axis=0, return_inverse=True)
    cells = cells.reshape(-1, 8)
    if kind == "tetrahedron":
        steps = 2 ** np.array(list(permutations(range(3))))
        paths = np.column_stack([np.zeros(6, int), steps[:, 0], steps[:, :2].sum(axis=1), np.full(6, 7)])
        paths[[1, 2, 5], 1:3] = paths[[1, 2, 5], 2:0:-1]  # odd permutations
        cells = cells[:, paths].reshape(-1, 4)
    return MeshSource(
        path=Path("block"),
        kind=kind,
        degree=1,
        points=points.astype(np.float64),
        node_tags=np.arange(1, len(points) + 1),
        cells=cells,
        cell_tags=np.arange(1, len(cells) + 1),
        facets=np.zeros((0, 3 if kind == "tetrahedron" else 4), dtype=np.int64),
    )
