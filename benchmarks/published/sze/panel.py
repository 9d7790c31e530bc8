"""A part of a cylinder around the y axis, from its lowest line on: the surface of a shell.

Groups: surface ``sheet``; edges ``x0`` (lowest line), ``x1``, ``y0``, ``y1``, and ``corner``, the first cell of ``y0``.
"""

from __future__ import annotations

from math import cos, sin
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Dimensionless, Divisions, Length


def build(
    gmsh: Any,
    *,
    radius: Length = 1.0,
    angle: Dimensionless = 1.0,
    width: Length = 1.0,
    strip: Length = 0.0,
    nx: Divisions = 8,
    ny: Divisions = 8,
) -> None:
    """Mesh nx × ny quadrilaterals.

    Args:
        strip: width of one more row of cells along ``x1``, which is inside of the angle; 0 for none.
    """
    geo, model = gmsh.model.geo, gmsh.model
    end = angle - strip / radius
    pieces = [(0.0, end / nx, 1), (end / nx, end, int(nx) - 1)] + ([(end, angle, 1)] if strip else [])
    angles = [pieces[0][0], *(stop for _, stop, _ in pieces)]
    points = [geo.addPoint(radius * sin(a), 0, radius * (1 - cos(a))) for a in angles]
    centre = geo.addPoint(0, 0, radius)
    arcs = [geo.addCircleArc(points[i], centre, points[i + 1]) for i in range(len(pieces))]
    for arc, (_, _, count) in zip(arcs, pieces, strict=True):
        geo.mesh.setTransfiniteCurve(arc, count + 1)
    swept = [geo.extrude([(1, arc)], 0, width, 0, [int(ny)], recombine=True) for arc in arcs]
    geo.synchronize()
    model.addPhysicalGroup(2, [part[1][1] for part in swept], name="sheet")
    sides = {tag for part in swept for _, tag in part[2:]}
    x0, x1 = (
        next(abs(tag) for tag in sides if abs(model.getBoundingBox(1, abs(tag))[0] - radius * sin(a)) < 1e-5 * radius)
        for a in (0.0, angle)
    )
    groups = {"x0": [x0], "x1": [x1], "y0": arcs, "y1": [abs(part[0][1]) for part in swept], "corner": arcs[:1]}
    for name, curves in groups.items():
        model.addPhysicalGroup(1, curves, name=name)
    model.mesh.generate(2)
