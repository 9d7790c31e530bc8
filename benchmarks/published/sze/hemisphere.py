"""A quarter of a hemisphere with a hole of 18° around its pole, the surface of a shell.

Groups: surface ``sheet``; edges ``y0`` and ``x0`` in the planes y = 0 and x = 0, ``hole``, and of the equator ``A`` and
``B``, one cell long, at y = 0 and x = 0.
"""

from __future__ import annotations

from math import cos, pi, sin
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions, Length


def build(gmsh: Any, *, radius: Length = 10.0, divisions: Divisions = 16) -> None:
    """Mesh divisions × divisions quadrilaterals."""
    geo, count = gmsh.model.geo, int(divisions)
    top = 0.4 * pi
    centre = geo.addPoint(0, 0, 0)
    ends = [geo.addPoint(radius * cos(a), 0, radius * sin(a)) for a in (0, top)]
    arc = geo.addCircleArc(ends[0], centre, ends[1])
    geo.mesh.setTransfiniteCurve(arc, count + 1)
    edges, patches, equator, hole = [arc], [], [], []
    for cells in (1, count - 2, 1):
        angle = pi / 2 * cells / count
        revolved = geo.revolve([(1, edges[-1])], 0, 0, 0, 0, 0, 1, angle, [cells], recombine=True)
        patches.append(revolved[1][1])
        edges.append(revolved[0][1])
        low, high = revolved[2][1], revolved[3][1]
        equator.append(low)
        hole.append(high)
    geo.synchronize()
    model = gmsh.model
    if model.getBoundingBox(1, abs(equator[0]))[5] > radius / 2:
        equator, hole = hole, equator
    model.addPhysicalGroup(2, patches, name="sheet")
    for name, curves in (
        ("y0", [edges[0]]),
        ("x0", [edges[-1]]),
        ("A", equator[:1]),
        ("B", equator[-1:]),
        ("hole", hole),
    ):
        model.addPhysicalGroup(1, [abs(curve) for curve in curves], name=name)
    model.mesh.generate(2)
    model.mesh.reverse([(2, patch) for patch in patches])  # normals outwards
