"""The beam of Land et al. (2015), 10 mm x 1 mm x 1 mm: the half with y ≤ 0.5 mm, of bricks.

Groups: volume ``beam``; surfaces ``clamp`` (x = 0), ``end`` (x = 10 mm), ``bottom`` (z = 0) and the plane of symmetry
``middle`` (y = 0.5 mm).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions

RATIO = 0.25
"""Thickness of a layer at the clamped edges over the thickness of all layers inside of it. Larger: a weaker grading."""


def build(gmsh: Any, *, n: Divisions = 1, layers: int = 2) -> None:
    """Mesh with ``layers`` towards the edges of the clamp, all cells cut in n × n × n."""
    thin = [RATIO**k for k in range(layers, 0, -1)]
    stations = [*thin, 1, 2, 3.5, 5, 7, 8.75, 10]
    low = [0.25 * t for t in thin]
    geo = gmsh.model.geo
    line = _extruded(geo, [(0, geo.addPoint(0, 0, 0))], (1, 0, 0), stations, n)[1]
    strip = _extruded(geo, [line], (0, 1, 0), [*low, 0.25, 0.5], n)
    _top, beam, *sides = _extruded(
        geo, [strip[1]], (0, 0, 1), [*low, 0.25, 0.5, 0.75, *(1 - t for t in low[::-1]), 1], n
    )
    geo.synchronize()
    gmsh.model.addPhysicalGroup(3, [beam[1]], name="beam")
    faces = {"bottom": [strip[1][1]]}
    for _, tag in sides:
        x0, y0, _, x1, _, _ = gmsh.model.getBoundingBox(2, tag)
        name = "clamp" if x1 < 1e-4 else "end" if x0 > 9.9e-3 else "middle" if y0 > 4e-4 else ""
        faces.setdefault(name, []).append(tag)
    for name in ("clamp", "end", "bottom", "middle"):
        gmsh.model.addPhysicalGroup(2, faces[name], name=name)
    gmsh.model.mesh.generate(3)


def _extruded(geo: Any, entities: list[Any], axis: tuple[int, int, int], ends: list[float], n: int) -> list[Any]:
    """Extrude by the last of ``ends`` (mm), with n cells from each of them to the next."""
    shift = [1e-3 * ends[-1] * component for component in axis]
    result: list[Any] = geo.extrude(entities, *shift, [n] * len(ends), [end / ends[-1] for end in ends], recombine=True)
    return result
