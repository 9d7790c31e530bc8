"""A quarter x, y ≥ 0 of a bellows along z, whose chambers are closed by plates and have walls in zigzag, of tetrahedra.

Groups: volume ``bellows``; surfaces ``bottom`` (z = 0), ``top``, ``chamber1``, ``chamber2``, …, the planes of symmetry
``x0``, ``y0``, and ``skin``.
"""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions, Length, Size


def build(
    gmsh: Any,
    *,
    narrow: Length = 0.008,
    wide: Length = 0.012,
    wall: Length = 0.002,
    fold: Length = 0.008,
    folds: Divisions = 2,
    chambers: Divisions = 1,
    size: Size = 0.003,
) -> None:
    """Mesh a stack of chambers between plates of thickness ``wall``; inner radii are ``narrow`` to ``wide``."""
    occ, folds = gmsh.model.occ, int(folds)
    height = folds * fold
    starts = [wall + i * (height + wall) for i in range(int(chambers))]
    top = starts[-1] + height + wall

    def zigzag(start: float, beyond: float) -> list[tuple[float, float]]:
        radii = [narrow, *([wide, narrow] * folds)]
        return [(r + beyond, start + i * fold / 2) for i, r in enumerate(radii)]

    def revolved(profile: list[tuple[float, float]]) -> tuple[int, int]:
        points = [occ.addPoint(r, 0, z) for r, z in profile]
        lines = [occ.addLine(a, b) for a, b in zip(points, [*points[1:], points[0]], strict=True)]
        surface = occ.addPlaneSurface([occ.addCurveLoop(lines)])
        (volume,) = [entity for entity in occ.revolve([(2, surface)], 0, 0, 0, 0, 0, 1, pi / 2) if entity[0] == 3]
        return 3, int(volume[1])

    outside = [(narrow + wall, 0.0), *(p for start in starts for p in zigzag(start, wall)), (narrow + wall, top)]
    body = revolved([(0, 0), *outside, (0, top)])
    holes = [revolved([(0, start), *zigzag(start, 0.0), (0, start + height)]) for start in starts]
    ((_, bellows),), _ = occ.cut([body], holes)
    occ.synchronize()
    groups: dict[str, list[int]] = {}
    near = 1e-3 * wall
    for _, face in gmsh.model.getBoundary([(3, bellows)], oriented=False):
        x0, y0, z0, x1, y1, z1 = gmsh.model.getBoundingBox(2, face)
        inside = [i for i, start in enumerate(starts, 1) if start - near < z0 and z1 < start + height + near]
        if x1 - x0 < near or y1 - y0 < near:
            name = "x0" if x1 - x0 < near else "y0"
        elif z1 < near or z0 > top - near:
            name = "bottom" if z1 < near else "top"
        else:
            name = f"chamber{inside[0]}" if inside and x1 < wide + near else "skin"
        groups.setdefault(name, []).append(face)
    for name, faces in groups.items():
        gmsh.model.addPhysicalGroup(2, faces, name=name)
    gmsh.model.addPhysicalGroup(3, [bellows], name="bellows")
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.MeshSizeMin", size)
    gmsh.model.mesh.generate(3)
