"""Half of a half-cylinder that lies on a block along y, of one layer of hexahedra.

Groups: volumes ``cylinder``, ``block``; surfaces ``bottom`` of the cylinder, which is round, and ``top`` of the block,
which face each other; the plane of symmetry ``x0``, the ends ``y0``, ``y1``, and ``z0``, ``z1`` below and above.
"""

from __future__ import annotations

from math import asin, cos, log
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hpcinv.base.quantity import Divisions, Length, Size

type _Place = tuple[float, float]


def build(
    gmsh: Any,
    *,
    radius: Size = 0.05,
    block: Size = 0.1,
    thickness: Size = 0.001,
    fine: Size = 0.008,
    divisions: Divisions = 10,
    more: Divisions = 1,
    gap: Length = 1e-7,
) -> None:
    """Mesh both with equal cells along x over ``fine`` from the line of contact, which then grow outwards.

    Args:
        block: its height, and half of its width.
        divisions: of the cylinder within ``fine``.
        more: by how many more the block has, so that nodes do not match.
        gap: between both; gmsh makes one point of points that are nearer.
    """
    n, rise = int(divisions), radius * (1 - cos(asin(fine / radius)))
    inner = [(0.0, gap), (fine, rise + gap), (0.93 * fine, fine + rise / 2 + gap), (0.0, fine + gap)]
    outer = [(radius, radius + gap), (radius / 2, radius + gap), (0.0, radius + gap)]
    growth = log(radius / fine)
    above = _quarter(gmsh, "cylinder", (inner, outer), (n, growth), thickness, centre=(0.0, radius + gap))
    inner = [(0.0, 0.0), (fine, 0.0), (fine, -fine), (0.0, -fine)]
    outer = [(block, 0.0), (block, -block), (0.0, -block)]
    below = _quarter(gmsh, "block", (inner, outer), (n + int(more), log(block / fine)), thickness)
    groups = {
        "bottom": above["touching"],
        "top": below["touching"],
        "z0": below["far"][1:],
        "z1": above["far"],
        **{name: above[name] + below[name] for name in ("x0", "y0", "y1")},
    }
    for name, surfaces in groups.items():
        gmsh.model.addPhysicalGroup(2, surfaces, name=name)
    gmsh.model.mesh.generate(3)


def _quarter(
    gmsh: Any,
    name: str,
    corners: tuple[Sequence[_Place], Sequence[_Place]],
    grading: tuple[int, float],
    thickness: float,
    centre: _Place | None = None,
) -> dict[str, list[int]]:
    """Mesh a body with a patch at the line of contact, and one patch on either side of its far corner.

    Args:
        corners: of the first patch: line of contact, along the surface, far corner, and back; and the ends of lines
            from the last three of them.
        grading: divisions of the first patch, and logarithm of the size of the body relative to it.
        centre: of a round surface.

    Returns:
        Surfaces by name: the one that may touch, the two far ones, the plane of symmetry and the ends.
    """
    geo, (n, growth) = gmsh.model.geo, grading
    o, p, i, a, w, d, h = (geo.addPoint(x, 0.0, z) for x, z in (*corners[0], *corners[1]))
    if centre is None:
        op, pw = geo.addLine(o, p), geo.addLine(p, w)
    else:
        middle = geo.addPoint(centre[0], 0.0, centre[1])
        op, pw = geo.addCircleArc(o, middle, p), geo.addCircleArc(p, middle, w)
    pi, ia, ao = geo.addLine(p, i), geo.addLine(i, a), geo.addLine(a, o)
    wd, dh, di, ah = geo.addLine(w, d), geo.addLine(d, h), geo.addLine(d, i), geo.addLine(a, h)
    outwards = max(2, round(n * growth / 1.8))
    for line in (op, pi, ia, ao, wd, dh):
        geo.mesh.setTransfiniteCurve(line, n + 1)
    for line, way in ((pw, 1), (di, -1), (ah, 1)):
        geo.mesh.setTransfiniteCurve(line, outwards + 1, "Progression", (1 + growth / outwards) ** way)
    loops = {(o, p, i, a): (op, pi, ia, ao), (p, w, d, i): (pw, wd, di, -pi), (a, i, d, h): (-ia, -di, dh, -ah)}
    patches = list[int]()
    for ends, loop in loops.items():
        patches.append(geo.addPlaneSurface([geo.addCurveLoop(loop)]))
        geo.mesh.setTransfiniteSurface(patches[-1], cornerTags=ends)
        geo.mesh.setRecombine(2, patches[-1])
    extruded = geo.extrude([(2, patch) for patch in patches], 0, thickness, 0, numElements=[1], recombine=True)
    geo.synchronize()
    first, second, third = (extruded[6 * k : 6 * k + 6] for k in range(3))  # end, volume, and the four sides of each
    gmsh.model.addPhysicalGroup(3, [part[1][1] for part in (first, second, third)], name=name)
    return {
        "touching": [first[2][1]],
        "far": [second[3][1], third[4][1]],
        "x0": [first[5][1], third[5][1]],
        "y0": patches,
        "y1": [part[0][1] for part in (first, second, third)],
    }
