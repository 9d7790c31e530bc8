"""A column [0, 1] × [0, 1] × [0, height] of thick layers with thin ones between, all cut into five tetrahedra a brick.

The middle tetrahedron of a thin brick has its four nodes nearly in one plane, far apart: a sliver, of the aspect ratio
that is asked for. Groups: volume ``block``; its surfaces are named by conditions in the job.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions, Length

TETRAHEDRON = 4  # gmsh's number
FIVE = ((0, 5, 3, 6), (1, 3, 0, 5), (2, 0, 3, 6), (4, 6, 5, 0), (7, 5, 6, 3))  # corners x + 2 y + 4 z of a brick


def build(gmsh: Any, *, height: Length = 1.0, layers: Divisions = 4, sides: Divisions = 1, aspect: float = 1e4) -> None:
    """Mesh ``layers`` thick layers, with thin ones between whose bricks are ``aspect`` times wider than high."""
    thin = 1.0 / sides / aspect
    heights = [0.0]
    for layer in range(1, layers):
        heights += [layer * height / layers, layer * height / layers + thin]
    heights.append(height)
    number = {}
    points = []
    for k, z in enumerate(heights):
        for j, i in product(range(sides + 1), repeat=2):
            number[i, j, k] = len(number) + 1
            points += [i / sides, j / sides, z]
    cells = []
    for i, j, k in product(range(sides), range(sides), range(len(heights) - 1)):
        # Bricks next to each other are mirror images, so that the diagonals of their common face agree.
        flip = (i % 2, j % 2, k % 2)
        corners = [
            number[tuple(a + (c >> axis & 1 ^ f) for axis, (a, f) in enumerate(zip((i, j, k), flip, strict=True)))]
            for c in range(8)
        ]
        for a, b, c, d in FIVE:
            around = [corners[n] for n in ((b, a, c, d) if sum(flip) % 2 else (a, b, c, d))]
            cells += around
    block = gmsh.model.addDiscreteEntity(3)
    gmsh.model.mesh.addNodes(3, block, list(number.values()), points)
    gmsh.model.mesh.addElementsByType(block, TETRAHEDRON, [], cells)
    gmsh.model.addPhysicalGroup(3, [block], name="block")
