"""A flat ring that is slit along the x axis, one cell thick.

Groups: volume ``ring``; surfaces ``clamp`` and ``end``, the two sides of the slit.
"""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions, Length


def build(
    gmsh: Any,
    *,
    inner: Length = 6.0,
    outer: Length = 10.0,
    thickness: Length = 0.03,
    across: Divisions = 4,
    around: Divisions = 40,
) -> None:
    """Mesh the ring with across × around × 1 hexahedra, ``around`` a multiple of 4."""
    gmsh.option.setNumber("Geometry.AutoCoherence", 0)  # the two sides of the slit stay apart
    geo = gmsh.model.geo
    points = [geo.addPoint(r, 0, z) for r, z in ((inner, 0), (outer, 0), (outer, thickness), (inner, thickness))]
    edges = [geo.addLine(points[i], points[(i + 1) % 4]) for i in range(4)]
    for edge, divisions in zip(edges, (across, 1, across, 1), strict=True):
        geo.mesh.setTransfiniteCurve(edge, int(divisions) + 1)
    clamp = geo.addPlaneSurface([geo.addCurveLoop(edges)])
    geo.mesh.setTransfiniteSurface(clamp)
    geo.mesh.setRecombine(2, clamp)
    end, quarters = clamp, []
    for _ in range(4):
        side, volume, *_ = geo.revolve([(2, end)], 0, 0, 0, 0, 0, 1, pi / 2, [int(around) // 4], recombine=True)
        end = side[1]
        quarters.append(volume[1])
    geo.synchronize()
    gmsh.model.addPhysicalGroup(2, [clamp], name="clamp")
    gmsh.model.addPhysicalGroup(2, [end], name="end")
    gmsh.model.addPhysicalGroup(3, quarters, name="ring")
    gmsh.model.mesh.generate(3)
