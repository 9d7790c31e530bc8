"""A block [0, lx] × [0, ly] × [0, lz] in regular divisions, of tetrahedra or hexahedra.

Groups: volume ``block``; surfaces ``x0``, ``x1``, ``y0``, ``y1``, ``z0``, ``z1``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions, Length


def build(
    gmsh: Any,
    *,
    lx: Length = 1.0,
    ly: Length = 1.0,
    lz: Length = 1.0,
    nx: Divisions = 4,
    ny: Divisions = 4,
    nz: Divisions = 4,
    hexahedra: bool = False,
) -> None:
    """Mesh the block with nx × ny × nz bricks, each left whole (``hexahedra``) or cut into six tetrahedra."""
    geo = gmsh.model.geo
    corners = [geo.addPoint(x, y, 0) for x, y in ((0, 0), (lx, 0), (lx, ly), (0, ly))]
    edges = [geo.addLine(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    bottom = geo.addPlaneSurface([geo.addCurveLoop(edges)])
    for edge, divisions in zip(edges, (nx, ny, nx, ny), strict=True):
        geo.mesh.setTransfiniteCurve(edge, int(divisions) + 1)
    geo.mesh.setTransfiniteSurface(bottom, cornerTags=corners)
    if hexahedra:
        geo.mesh.setRecombine(2, bottom)
    top, block, *sides = geo.extrude([(2, bottom)], 0, 0, lz, [int(nz)], recombine=bool(hexahedra))
    geo.synchronize()
    faces = {"z0": bottom, "z1": top[1]} | {n: s[1] for n, s in zip(("y0", "x1", "y1", "x0"), sides, strict=True)}
    for name, surface in faces.items():
        gmsh.model.addPhysicalGroup(2, [surface], name=name)
    gmsh.model.addPhysicalGroup(3, [block[1]], name="block")
    gmsh.model.mesh.generate(3)
