"""A bar with a round section along an arc of 45 degrees in the plane of x and z, from the x axis on.

Groups: volume ``bar``; surfaces ``clamp`` (x = 0) and ``end``.
"""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions, Length


def build(gmsh: Any, *, radius: Length = 100.0, section: Length = 0.570732, along: Divisions = 24) -> None:
    """Mesh the bar of radius ``section`` with tetrahedra in ``along`` slices."""
    occ = gmsh.model.occ
    clamp = occ.addDisk(0, 0, 0, section, section, zAxis=[1, 0, 0])
    end, bar, *_ = occ.revolve([(2, clamp)], 0, 0, radius, 0, 1, 0, -pi / 4, [int(along)])
    occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMin", 2 * section)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 2 * section)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 8)
    gmsh.model.addPhysicalGroup(2, [clamp], name="clamp")
    gmsh.model.addPhysicalGroup(2, [end[1]], name="end")
    gmsh.model.addPhysicalGroup(3, [bar[1]], name="bar")
    gmsh.model.mesh.generate(3)
