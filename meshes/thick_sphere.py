"""An octant x, y, z ≥ 0 of a hollow sphere around the origin, in regular divisions, of tetrahedra or hexahedra.

Groups: volume ``wall``; surfaces ``inner``, ``outer``, and the planes of symmetry ``x0``, ``y0``, ``z0``.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from math import hypot
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions, Length

# Rays from the origin, of any length: through the middle, the axes, and between each axis and the next.
MIDDLE = (1, 1, 1)
AXES = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
BETWEEN = ((1, 1, 0), (0, 1, 1), (1, 0, 1))

type Ray = tuple[int, int, int]


def build(
    gmsh: Any,
    *,
    inner: Length = 0.5,
    outer: Length = 1.0,
    radial: Divisions = 4,
    along: Divisions = 4,
    hexahedra: bool = False,
    shells: bool = True,
) -> None:
    """Mesh the octant with radial × along × along bricks in each of three blocks, whole or cut into six tetrahedra.

    The blocks meet on the ray (1, 1, 1), and each reaches from there to one of the axes. Between ``shells``, faces of
    curved cells lie on spheres, as an interface of two layers does; without, they are straight inside the wall.
    """
    geo, count = gmsh.model.geo, int(radial) if shells else 1
    centre = geo.addPoint(0, 0, 0)

    @cache
    def point(ray: Ray, radius: float) -> int:
        return int(geo.addPoint(*(radius * c / hypot(*ray) for c in ray)))

    @cache
    def line(ray: Ray, low: float, high: float) -> int:
        tag = int(geo.addLine(point(ray, low), point(ray, high)))
        geo.mesh.setTransfiniteCurve(tag, int(radial) // count + 1)
        return tag

    @cache
    def arc(start: Ray, end: Ray, radius: float) -> int:
        tag = int(geo.addCircleArc(point(start, radius), centre, point(end, radius)))
        geo.mesh.setTransfiniteCurve(tag, int(along) + 1)
        return tag

    def divided(surface: int, corners: list[int]) -> int:
        # Corners are counted from the middle ray and outwards, and the volumes' too: then the diagonals agree.
        geo.mesh.setTransfiniteSurface(surface, "Left", corners)
        if hexahedra:
            geo.mesh.setRecombine(2, surface)
        return surface

    @cache
    def side(start: Ray, end: Ray, low: float, high: float) -> int:
        ends = line(start, low, high), line(end, low, high)
        loop = geo.addCurveLoop([arc(start, end, low), ends[1], -arc(start, end, high), -ends[0]])
        corners = [point(start, low), point(end, low), point(end, high), point(start, high)]
        return divided(geo.addPlaneSurface([loop]), corners)

    @cache
    def patch(rays: tuple[Ray, Ray, Ray, Ray], radius: float) -> int:
        middle, one, axis, other = rays
        loop = geo.addCurveLoop(
            [
                arc(middle, one, radius),
                arc(one, axis, radius),
                -arc(other, axis, radius),
                -arc(middle, other, radius),
            ]
        )
        surface = geo.addSurfaceFilling([loop], sphereCenterTag=centre)
        return divided(surface, [point(ray, radius) for ray in rays])

    radii = [inner + (outer - inner) * i / count for i in range(count + 1)]
    blocks = [(MIDDLE, BETWEEN[i], axis, BETWEEN[i - 1]) for i, axis in enumerate(AXES)]
    layers = list(pairwise(radii))
    volumes = []
    for rays in blocks:
        middle, one, axis, other = rays
        for low, high in layers:
            sides = [side(*ends, low, high) for ends in ((middle, one), (one, axis), (other, axis), (middle, other))]
            volume = geo.addVolume([geo.addSurfaceLoop([patch(rays, low), *sides, patch(rays, high)])])
            geo.mesh.setTransfiniteVolume(volume, [point(ray, radius) for radius in (low, high) for ray in rays])
            volumes.append(volume)
    groups = {name: [patch(rays, radius) for rays in blocks] for name, radius in (("inner", inner), ("outer", outer))}
    for i, name in enumerate(("x0", "y0", "z0")):
        ends = [(ray, axis) for ray in BETWEEN for axis in AXES if ray[i] == axis[i] == 0]
        groups[name] = [side(*pair, *layer) for pair in ends for layer in layers]
    geo.synchronize()
    for name, surfaces in groups.items():
        gmsh.model.addPhysicalGroup(2, surfaces, name=name)
    gmsh.model.addPhysicalGroup(3, volumes, name="wall")
    gmsh.model.mesh.generate(3)
