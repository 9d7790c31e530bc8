"""A block [0, lx] × [0, ly] × [0, lz] of tetrahedra that become ever smaller towards the origin.

Groups: volume ``block``; its surfaces are named by conditions in the job.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Length, Size


def build(
    gmsh: Any, *, lx: Length = 1.0, ly: Length = 1.0, lz: Length = 1.0, size: Size = 0.25, ratio: float = 1e3
) -> None:
    """Mesh with cells of ``size`` (m) at the far corners and ``ratio`` times smaller ones at the origin."""
    occ = gmsh.model.occ
    block = occ.addBox(0, 0, 0, lx, ly, lz)
    occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMin", size / ratio)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    for _, corner in gmsh.model.getEntities(0):
        at_origin = max(map(abs, gmsh.model.getValue(0, corner, []))) < 1e-6 * lx
        gmsh.model.mesh.setSize([(0, corner)], size / ratio if at_origin else size)
    gmsh.model.addPhysicalGroup(3, [block], name="block")
    gmsh.model.mesh.generate(3)
