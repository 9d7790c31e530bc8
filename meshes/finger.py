"""A round finger along x with a closed chamber next to its axis, of tetrahedra: the half y ≤ 0.

Groups: volume ``finger``; surfaces ``base`` (x = 0), ``chamber``, ``y0`` (the plane of symmetry) and ``skin``.
"""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Length, Size


def build(
    gmsh: Any,
    *,
    length: Length = 0.08,
    radius: Length = 0.008,
    chamber: Length = 0.003,
    offset: Length = 0.003,
    wall: Length = 0.006,
    size: Size = 0.004,
) -> None:
    """Mesh a finger with a chamber of ``2 * chamber`` across, ``wall`` from its ends and ``offset`` above its axis."""
    occ = gmsh.model.occ
    body = occ.addCylinder(0, 0, 0, length, 0, 0, radius, angle=pi)
    hole = occ.addBox(wall, -chamber, offset - chamber, length - 2 * wall, chamber, 2 * chamber)
    ((_, finger),), _ = occ.cut([(3, body)], [(3, hole)])
    occ.synchronize()
    groups: dict[str, list[int]] = {"base": [], "chamber": [], "y0": [], "skin": []}
    for _, face in gmsh.model.getBoundary([(3, finger)], oriented=False):
        x, y, _ = occ.getCenterOfMass(2, face)
        low, high = (gmsh.model.getBoundingBox(2, face)[i] for i in (0, 3))
        if abs(x) < 1e-6 * length:
            name = "base"
        elif abs(y) < 1e-6 * radius:
            name = "y0"
        elif low > wall / 2 and high < length - wall / 2:
            name = "chamber"
        else:
            name = "skin"
        groups[name].append(face)
    for name, faces in groups.items():
        gmsh.model.addPhysicalGroup(2, faces, name=name)
    gmsh.model.addPhysicalGroup(3, [finger], name="finger")
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.MeshSizeMin", size)
    gmsh.model.mesh.generate(3)
