"""The silicone (PDMS) beam of the paper: a circular cylinder along x from x = 0.

Groups: volume ``silicone``; surfaces ``clamp`` (x = 0), ``tip`` (x = length), ``side``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Length, Size


def build(gmsh: Any, *, length: Length = 0.182, diameter: Length = 0.0085, size: Size = 0.002) -> None:
    """Mesh a cylinder of the given length and diameter with tetrahedra of the given size (m)."""
    occ = gmsh.model.occ
    beam = occ.addCylinder(0, 0, 0, length, 0, 0, diameter / 2)
    occ.synchronize()
    for _, surface in gmsh.model.getEntities(2):
        x, _, _ = occ.getCenterOfMass(2, surface)
        name = "clamp" if x < 0.25 * length else "tip" if x > 0.75 * length else "side"
        gmsh.model.addPhysicalGroup(2, [surface], name=name)
    gmsh.model.addPhysicalGroup(3, [beam], name="silicone")
    gmsh.option.setNumber("Mesh.MeshSizeMin", size)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.model.mesh.generate(3)
