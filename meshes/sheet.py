"""A rectangle [0, length] × [0, width] of quadrilaterals in the plane z = 0, flat or rolled: the surface of a shell.

Groups: surface ``sheet``; edges ``x0``, ``x1``, ``y0``, ``y1``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions, Length


def build(
    gmsh: Any,
    *,
    length: Length = 1.0,
    width: Length = 0.2,
    radius: Length = 0.0,
    nx: Divisions = 10,
    ny: Divisions = 2,
) -> None:
    """Mesh nx × ny quadrilaterals.

    Args:
        radius: of the cylinder along y on which the sheet rises from its edge x0 upwards; 0 for a flat sheet.
    """
    occ = gmsh.model.occ
    if radius:
        angle = length / radius
        ends = [occ.addPoint(radius * math.sin(a), 0, radius * (1 - math.cos(a))) for a in (0.0, angle)]
        line = occ.addCircleArc(ends[0], occ.addPoint(0, 0, radius), ends[1])
    else:
        ends = [occ.addPoint(x, 0, 0) for x in (0.0, length)]
        line = occ.addLine(*ends)
    swept = occ.extrude([(1, line)], 0, width, 0)
    surface = next(tag for dim, tag in swept if dim == 2)
    occ.synchronize()
    model = gmsh.model
    far = next(tag for dim, tag in swept if dim == 1)
    sides = [abs(tag) for _, tag in model.getBoundary([(2, surface)], oriented=False) if abs(tag) not in (line, far)]
    sides.sort(key=lambda tag: ends[0] not in [point for _, point in model.getBoundary([(1, tag)], oriented=False)])
    for tag, divisions in ((line, nx), (far, nx), (sides[0], ny), (sides[1], ny)):
        model.mesh.setTransfiniteCurve(tag, int(divisions) + 1)
    model.mesh.setTransfiniteSurface(surface)
    model.mesh.setRecombine(2, surface)
    model.addPhysicalGroup(2, [surface], name="sheet")
    for name, tag in zip(("y0", "y1", "x0", "x1"), (line, far, *sides), strict=True):
        model.addPhysicalGroup(1, [tag], name=name)
    model.mesh.generate(2)
