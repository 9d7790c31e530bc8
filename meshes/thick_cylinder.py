"""A thick tube around the z axis from z = 0, or its quarter x, y ≥ 0, in regular divisions, of tetrahedra or hexahedra.

Groups: volume ``wall``; surfaces ``inner``, ``outer``, ``z0``, ``z1``, and ``x0``, ``y0`` where the quarter is cut.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions, Length

RAYS = ((1, 0), (0, 1), (-1, 0), (0, -1))


def build(
    gmsh: Any,
    *,
    length: Length = 1.0,
    inner: Length = 0.5,
    outer: Length = 1.0,
    quarter: bool = True,
    radial: Divisions = 4,
    around: Divisions = 4,
    along: Divisions = 4,
    hexahedra: bool = False,
) -> None:
    """Mesh each quarter with radial × around × along bricks, whole (``hexahedra``) or cut into six tetrahedra."""
    geo = gmsh.model.geo
    centre = geo.addPoint(0, 0, 0)
    near, far = ([geo.addPoint(radius * x, radius * y, 0) for x, y in RAYS] for radius in (inner, outer))
    lines = [geo.addLine(*ends) for ends in zip(near, far, strict=True)]
    ends = []
    for i in range(1 if quarter else len(RAYS)):
        j = (i + 1) % len(RAYS)
        arcs = [geo.addCircleArc(points[i], centre, points[j]) for points in (near, far)]
        for curve, divisions in ((lines[i], radial), (lines[j], radial), *((arc, around) for arc in arcs)):
            geo.mesh.setTransfiniteCurve(curve, int(divisions) + 1)
        end = geo.addPlaneSurface([geo.addCurveLoop([lines[i], arcs[1], -lines[j], -arcs[0]])])
        geo.mesh.setTransfiniteSurface(end, cornerTags=[near[i], far[i], far[j], near[j]])
        if hexahedra:
            geo.mesh.setRecombine(2, end)
        ends.append(end)
    extruded = geo.extrude([(2, end) for end in ends], 0, 0, length, [int(along)], recombine=bool(hexahedra))
    geo.synchronize()
    # Of each quarter: its other end, its volume, and its sides in the order of the loop.
    parts = [[tag for _, tag in extruded[6 * i : 6 * i + 6]] for i in range(len(ends))]
    groups = {"z0": ends, "z1": [p[0] for p in parts], "outer": [p[3] for p in parts], "inner": [p[5] for p in parts]}
    if quarter:
        groups |= {"y0": [parts[0][2]], "x0": [parts[0][4]]}
    for name, surfaces in groups.items():
        gmsh.model.addPhysicalGroup(2, surfaces, name=name)
    gmsh.model.addPhysicalGroup(3, [p[1] for p in parts], name="wall")
    gmsh.model.mesh.generate(3)
