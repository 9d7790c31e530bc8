"""Cook's membrane: the quadrilateral (0, 0), (48, 44), (48, 60), (0, 44) mm, one cell of 1 mm thick.

Groups: volume ``membrane``; surfaces ``clamp``, ``end``, ``front``, ``back``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions


def build(gmsh: Any, *, n: Divisions = 4, hexahedra: bool = True, bump: float = 1.0) -> None:
    """Mesh the membrane with n × n × 1 bricks, each left whole (``hexahedra``) or cut into tetrahedra.

    ``bump``: 1 for equal cells; less makes those at the corners smaller (gmsh's coefficient).
    """
    geo = gmsh.model.geo
    corners = [geo.addPoint(x, y, 0) for x, y in ((0, 0), (0.048, 0.044), (0.048, 0.06), (0, 0.044))]
    edges = [geo.addLine(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    back = geo.addPlaneSurface([geo.addCurveLoop(edges)])
    for edge in edges:
        geo.mesh.setTransfiniteCurve(edge, int(n) + 1, "Bump", bump)
    geo.mesh.setTransfiniteSurface(back, cornerTags=corners)
    if hexahedra:
        geo.mesh.setRecombine(2, back)
    front, membrane, _, end, _, clamp = geo.extrude([(2, back)], 0, 0, 0.001, [1], recombine=bool(hexahedra))
    geo.synchronize()
    for name, surface in {"back": back, "front": front[1], "end": end[1], "clamp": clamp[1]}.items():
        gmsh.model.addPhysicalGroup(2, [surface], name=name)
    gmsh.model.addPhysicalGroup(3, [membrane[1]], name="membrane")
    gmsh.model.mesh.generate(3)
