"""A quarter of a wedge between two rough walls, one of which is meshed, of hexahedra.

Groups: volumes ``wedge``, ``wall``; surfaces ``side`` of the wedge and ``face`` of the wall, which face each other,
``x0`` and ``y0`` of the wedge in its planes of symmetry, ``top`` of the wedge, and ``back`` around the wall.
"""

from __future__ import annotations

import math
from typing import Any


def build(gmsh: Any, *, angle: float = 25.0, cells: int = 2) -> None:
    """Mesh a wedge of 60 mm with a half width of 30 mm below, whose side leans outwards by an angle in degrees."""
    slope = math.tan(math.radians(angle))
    wedge = _block(gmsh, (0.0, 0.0, 0.0), (0.03, 0.015, 0.06), (cells, 1, 2 * cells))
    wall = _block(gmsh, (0.03, -0.005, -0.01), (0.01, 0.025, 0.08), (1, 1, 1))
    for name, surfaces in (
        ("x0", [wedge["x0"]]),
        ("y0", [wedge["y0"]]),
        ("top", [wedge["z1"]]),
        ("side", [wedge["x1"]]),
        ("face", [wall["x0"]]),
        ("back", [wall[name] for name in ("x1", "y0", "y1", "z0", "z1")]),
    ):
        gmsh.model.addPhysicalGroup(2, surfaces, name=name)
    for name, block in (("wedge", wedge), ("wall", wall)):
        gmsh.model.addPhysicalGroup(3, [block["volume"]], name=name)
    gmsh.model.mesh.generate(3)
    for block in (wedge, wall):
        nodes, places, _ = gmsh.model.mesh.getNodes(3, block["volume"], includeBoundary=True)
        for node, (x, y, z) in zip(nodes, places.reshape(-1, 3), strict=True):
            gmsh.model.mesh.setNode(node, [x + z * slope * min(x / 0.03, 1.0), y, z], [])


def _block(gmsh: Any, low: tuple[float, ...], sizes: tuple[float, ...], divisions: tuple[int, ...]) -> dict[str, int]:
    volume = gmsh.model.occ.addBox(*low, *sizes)
    gmsh.model.occ.synchronize()
    named = {"volume": volume}
    for _, surface in gmsh.model.getBoundary([(3, volume)], oriented=False):
        box = gmsh.model.getBoundingBox(2, surface)
        axis = min(range(3), key=lambda i: box[3 + i] - box[i])
        named[f"{'xyz'[axis]}{int(box[axis] - low[axis] > sizes[axis] / 2)}"] = surface
        for _, edge in gmsh.model.getBoundary([(2, surface)], oriented=False):
            ends = gmsh.model.getBoundingBox(1, edge)
            along = max(range(3), key=lambda i: ends[3 + i] - ends[i])
            gmsh.model.mesh.setTransfiniteCurve(edge, divisions[along] + 1)
        gmsh.model.mesh.setTransfiniteSurface(surface)
        gmsh.model.mesh.setRecombine(2, surface)
    gmsh.model.mesh.setTransfiniteVolume(volume)
    return named
