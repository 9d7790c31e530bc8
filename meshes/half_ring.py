"""Half of a ring around the z axis, x ≥ 0, of hexahedra.

Groups: volume ``wall``; surfaces ``outer``, ``inner`` with its halves ``lower`` (y ≤ 0) and ``upper``, ``x0`` where the
ring is cut, and ``z0``, ``z1``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions, Length

RAYS = ((0, -1), (1, 0), (0, 1))


def build(
    gmsh: Any,
    *,
    radius: Length = 1.0,
    thickness: Length = 0.05,
    width: Length = 0.1,
    around: Divisions = 16,
    through: Divisions = 1,
) -> None:
    """Mesh each quarter with ``around`` × ``through`` cells; ``radius`` is the middle line's."""
    geo = gmsh.model.geo
    centre = geo.addPoint(0, 0, 0)
    radii = (radius - thickness / 2, radius + thickness / 2)
    near, far = ([geo.addPoint(r * x, r * y, 0) for x, y in RAYS] for r in radii)
    lines = [geo.addLine(*ends) for ends in zip(near, far, strict=True)]
    ends = []
    for i in range(2):
        arcs = [geo.addCircleArc(points[i], centre, points[i + 1]) for points in (near, far)]
        for curve, divisions in ((lines[i], through), (lines[i + 1], through), *((arc, around) for arc in arcs)):
            geo.mesh.setTransfiniteCurve(curve, int(divisions) + 1)
        end = geo.addPlaneSurface([geo.addCurveLoop([lines[i], arcs[1], -lines[i + 1], -arcs[0]])])
        geo.mesh.setTransfiniteSurface(end, cornerTags=[near[i], far[i], far[i + 1], near[i + 1]])
        geo.mesh.setRecombine(2, end)
        ends.append(end)
    extruded = geo.extrude([(2, end) for end in ends], 0, 0, width, [1], recombine=True)
    geo.synchronize()
    # Of each quarter: its other end, its volume, and its sides in the order of the loop.
    lower, upper = ([tag for _, tag in extruded[6 * i : 6 * i + 6]] for i in range(2))
    groups = {
        "z0": ends,
        "z1": [lower[0], upper[0]],
        "x0": [lower[2], upper[4]],
        "outer": [lower[3], upper[3]],
        "inner": [lower[5], upper[5]],
        "lower": [lower[5]],
        "upper": [upper[5]],
    }
    for name, surfaces in groups.items():
        gmsh.model.addPhysicalGroup(2, surfaces, name=name)
    gmsh.model.addPhysicalGroup(3, [lower[1], upper[1]], name="wall")
    gmsh.model.mesh.generate(3)
