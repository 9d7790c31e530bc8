"""The unit cube in n × n × n bricks, each cut into the six tetrahedra around its diagonal from the origin's side.

Groups: volume ``cube``; surfaces ``held`` (x = 0, x = 1, y = 0 and y = 1) and ``free`` (z = 0 and z = 1).
"""

from __future__ import annotations

from itertools import permutations
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions

TETRAHEDRON, TRIANGLE = 4, 2
"""Types of elements of gmsh."""


def build(gmsh: Any, *, n: Divisions = 5) -> None:
    """Mesh the cube."""
    n = int(n)
    rows = np.stack(np.meshgrid(*[np.arange(n + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    weights = np.array([(n + 1) ** 2, n + 1, 1])
    paths = [np.cumsum([np.zeros(3, int), *np.eye(3, dtype=int)[list(p)]], axis=0) for p in permutations(range(3))]
    bricks = rows[(rows < n).all(axis=1)]
    turned = [path if np.linalg.det(np.diff(path, axis=0)) > 0 else path[[0, 2, 1, 3]] for path in paths]
    cells = np.array([(brick + path) @ weights for brick in bricks for path in turned])
    facets = np.unique(np.sort([np.delete(cell, i) for cell in cells for i in range(4)]), axis=0)
    on_side = [(rows[facets][:, :, i] == side).all(axis=1) for i in range(3) for side in (0, n)]
    surfaces = {"held": np.any(on_side[:4], axis=0), "free": np.any(on_side[4:], axis=0)}
    model = gmsh.model
    cube = model.addDiscreteEntity(3)
    model.mesh.addNodes(3, cube, np.arange(1, len(rows) + 1), (rows / n).ravel())
    model.mesh.addElementsByType(cube, TETRAHEDRON, [], (cells + 1).ravel())
    model.addPhysicalGroup(3, [cube], name="cube")
    for name, chosen in surfaces.items():
        surface = model.addDiscreteEntity(2)
        model.mesh.addElementsByType(surface, TRIANGLE, [], (facets[chosen] + 1).ravel())
        model.addPhysicalGroup(2, [surface], name=name)
