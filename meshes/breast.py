"""Half an ellipsoid on the plane z = 0, the chest wall, with gland inside of fat, of tetrahedra.

Groups: volumes ``gland`` and ``fat``; surfaces ``wall`` (z = 0) and ``skin``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Length, Size


def build(
    gmsh: Any,
    *,
    radius: Length = 0.065,
    height: Length = 0.07,
    gland_radius: Length = 0.04,
    gland_height: Length = 0.05,
    size: Size = 0.015,
) -> None:
    """Mesh a half-ellipsoid of ``radius`` at the wall and of a height, and a smaller one inside of it."""
    occ, halves = gmsh.model.occ, list[tuple[int, int]]()
    for r, h in ((radius, height), (gland_radius, gland_height)):
        half = occ.addSphere(0, 0, 0, r, angle1=0)
        occ.dilate([(3, half)], 0, 0, 0, 1, 1, h / r)
        halves.append((3, half))
    volumes, (_, gland) = occ.fragment(halves[:1], halves[1:])
    occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in gland], name="gland")
    gmsh.model.addPhysicalGroup(3, [tag for dim, tag in volumes if (dim, tag) not in gland], name="fat")
    outside = gmsh.model.getBoundary(volumes, combined=True, oriented=False)
    wall = [tag for _, tag in outside if abs(occ.getCenterOfMass(2, tag)[2]) < 1e-6 * height]
    gmsh.model.addPhysicalGroup(2, wall, name="wall")
    gmsh.model.addPhysicalGroup(2, [tag for _, tag in outside if tag not in wall], name="skin")
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.MeshSizeMin", size)
    gmsh.model.mesh.generate(3)
