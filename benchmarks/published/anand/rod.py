"""A slice of a cylinder along z, of tetrahedra.

Groups: volume ``rod``; surfaces ``bottom`` (z = 0), ``top`` and ``side``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Length


def build(gmsh: Any, *, radius: Length = 0.0127, length: Length = 0.003175, size: Length = 0.004) -> None:
    """Mesh the slice with cells of about ``size``."""
    occ = gmsh.model.occ
    bottom = occ.addDisk(0, 0, 0, radius, radius)
    top, rod, side = occ.extrude([(2, bottom)], 0, 0, length)
    occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMin", size)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    for name, dimension, tag in (("bottom", 2, bottom), ("top", *top), ("side", *side), ("rod", *rod)):
        gmsh.model.addPhysicalGroup(dimension, [tag], name=name)
    gmsh.model.mesh.generate(3)
