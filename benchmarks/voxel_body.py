"""A random body of cubes in [0, 1]³, each cut into six tetrahedra: a lattice, a tree, a sponge, or leaves on a stem.

Group: volume ``body``. The lattice, the sponge and the leaves stand on z = 0; the tree begins at x = 0.
"""

from __future__ import annotations

from itertools import permutations
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions

TETRAHEDRON = 4  # gmsh's number
type Voxels = npt.NDArray[np.bool_]


def build(gmsh: Any, *, kind: str = "lattice", cells: Divisions = 12, seed: int = 0) -> None:
    """Mesh a "lattice", "tree", "sponge" or "leaves" of ``cells`` cubes along each axis."""
    draw = np.random.default_rng(seed)
    shape = {"lattice": _lattice, "tree": _tree, "sponge": _sponge, "leaves": _leaves}[kind](cells, draw)
    corners = np.argwhere(_connected(shape))
    tetrahedra = []
    for order in permutations(range(3)):  # the paths from a corner to the opposite one
        steps = np.zeros((4, 3), dtype=int)
        for number, axis in enumerate(order):
            steps[number + 1 :, axis] += 1
        if np.linalg.det(steps[1:]) < 0:
            steps[[2, 3]] = steps[[3, 2]]
        tetrahedra.append(corners[:, None] + steps)
    places = np.concatenate(tetrahedra).reshape(-1, 3)
    points, nodes = np.unique(places, axis=0, return_inverse=True)
    body = gmsh.model.addDiscreteEntity(3)
    gmsh.model.mesh.addNodes(3, body, list(range(1, len(points) + 1)), (points / cells).ravel().tolist())
    gmsh.model.mesh.addElementsByType(body, TETRAHEDRON, [], (nodes.ravel() + 1).tolist())
    gmsh.model.addPhysicalGroup(3, [body], name="body")


def _lattice(n: int, _: np.random.Generator) -> Voxels:
    """Struts of two cubes along the axes, with holes of four."""
    is_strut = np.arange(n) % 6 < 2
    x, y, z = is_strut[:, None, None], is_strut[None, :, None], is_strut[None, None, :]
    voxels: Voxels = x & y | y & z | z & x
    return voxels


def _tree(n: int, draw: np.random.Generator) -> Voxels:
    """A trunk along x with branches that begin anywhere and end at the sides."""
    voxels = np.zeros((n, n, n), dtype=bool)
    middle, half = n // 2, max(n // 12, 1)
    voxels[:, middle - half : middle + half, middle - half : middle + half] = True
    for _ in range(n // 2):
        axis, side = draw.integers(1, 3), draw.integers(2)
        begin = draw.integers(n - 1)
        away = slice(middle, n) if side else slice(0, middle)
        near = slice(middle - 1, middle + 1)
        voxels[(slice(begin, begin + 2), away, near) if axis == 1 else (slice(begin, begin + 2), near, away)] = True
    return voxels


def _sponge(n: int, draw: np.random.Generator) -> Voxels:
    """A cube with random holes of three cubes."""
    voxels = np.ones((n, n, n), dtype=bool)
    for hole in draw.integers(0, n - 2, (n**3 // 60, 3)):
        voxels[tuple(slice(place, place + 3) for place in hole)] = False
    voxels[:, :, 0] = True
    return voxels


def _leaves(n: int, draw: np.random.Generator) -> Voxels:
    """Horizontal sheets of one cube on a stem along z."""
    voxels = np.zeros((n, n, n), dtype=bool)
    middle = n // 2
    voxels[middle - 2 : middle + 2, middle - 2 : middle + 2] = True
    for height in range(3, n, 4):
        begin, end = draw.integers(0, middle - 2, 2), draw.integers(middle + 2, n, 2)
        voxels[begin[0] : end[0], begin[1] : end[1], height] = True
    return voxels


def _connected(voxels: Voxels) -> Voxels:
    """Return the cubes that are joined by faces to the first one on z = 0, or on x = 0 if there is none."""
    start = np.zeros_like(voxels)
    bottom = voxels[:, :, 0]
    seeds = np.argwhere(bottom) if bottom.any() else np.argwhere(voxels[0])
    start[(*seeds[0], 0) if bottom.any() else (0, *seeds[0])] = True
    while True:
        grown = start.copy()
        for axis in range(3):
            low, high = [slice(None)] * 3, [slice(None)] * 3
            low[axis], high[axis] = slice(None, -1), slice(1, None)
            grown[tuple(high)] |= start[tuple(low)]
            grown[tuple(low)] |= start[tuple(high)]
        grown &= voxels
        if (grown == start).all():
            return grown
        start = grown
