"""An ellipsoid, of tetrahedra, as an example of an organ.

Groups: volume ``body``; surface ``outside``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Length, Size


def build(gmsh: Any, *, length: Length = 0.2, width: Length = 0.14, height: Length = 0.08, size: Size = 0.016) -> None:
    """Mesh an ellipsoid with these axes along x, y and z, around the origin."""
    occ = gmsh.model.occ
    ball = occ.addSphere(0, 0, 0, length / 2)
    occ.dilate([(3, ball)], 0, 0, 0, 1, width / length, height / length)
    occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [ball], name="body")
    gmsh.model.addPhysicalGroup(2, [tag for _, tag in gmsh.model.getEntities(2)], name="outside")
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.MeshSizeMin", size)
    gmsh.model.mesh.generate(3)
