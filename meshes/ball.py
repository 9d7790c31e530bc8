"""An octant x, y, z ≥ 0 of a ball around the origin, of tetrahedra that are small near its pole (0, 0, radius).

Groups: volume ``ball``; surfaces ``outer`` and the planes of symmetry ``x0``, ``y0``, ``z0``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Size


def build(gmsh: Any, *, radius: Size = 1.0, size: Size = 0.3, at_pole: Size = 0.02, extent: Size = 0.1) -> None:
    """Mesh the octant with cells of ``at_pole`` within ``extent`` of the pole, which grow to ``size`` away from it."""
    occ = gmsh.model.occ
    ball = occ.addSphere(0, 0, 0, radius, angle1=0, angle3=1.5707963267948966)
    occ.synchronize()
    groups: dict[str, list[int]] = {name: [] for name in ("outer", "x0", "y0", "z0")}
    for _, surface in gmsh.model.getBoundary([(3, ball)], oriented=False):
        middle = occ.getCenterOfMass(2, surface)
        flat = [name for name, c in zip(("x0", "y0", "z0"), middle, strict=True) if abs(c) < 1e-6 * radius]
        groups[flat[0] if flat else "outer"].append(surface)
    for name, surfaces in groups.items():
        gmsh.model.addPhysicalGroup(2, surfaces, name=name)
    gmsh.model.addPhysicalGroup(3, [ball], name="ball")
    field = gmsh.model.mesh.field
    near = field.add("Ball")
    for name, value in (
        ("VIn", at_pole),
        ("VOut", size),
        ("ZCenter", radius),
        ("Radius", extent),
        ("Thickness", 2.5 * size),
    ):
        field.setNumber(near, name, value)
    field.setAsBackgroundMesh(near)
    for option in ("MeshSizeFromPoints", "MeshSizeExtendFromBoundary", "MeshSizeFromCurvature"):
        gmsh.option.setNumber(f"Mesh.{option}", 0)
    gmsh.model.mesh.generate(3)
