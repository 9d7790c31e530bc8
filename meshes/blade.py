"""A twisted plate along x, whose rectangular sections taper, of tetrahedra.

Groups: volume ``blade``; surfaces ``root`` (x = 0), ``tip`` and ``surface``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Length, Size


def build(
    gmsh: Any,
    *,
    span: Length = 0.1,
    chord: Length = 0.04,
    thickness: Length = 0.005,
    taper: float = 0.7,
    twist: float = 0.6,
    size: Size = 0.006,
) -> None:
    """Mesh a blade whose sections turn by ``twist`` (rad) and shrink to ``taper`` from the root to the tip."""
    occ, sections, count = gmsh.model.occ, [], 5
    for i in range(count):
        share = i / (count - 1)
        scale = 1 + share * (taper - 1)
        corners = [
            occ.addPoint(share * span, side * scale * thickness / 2, end * scale * chord / 2)
            for side, end in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        occ.rotate([(0, corner) for corner in corners], 0, 0, 0, 1, 0, 0, share * twist)
        edges = [occ.addLine(corners[k], corners[(k + 1) % 4]) for k in range(4)]
        sections.append(occ.addCurveLoop(edges))
    ((_, blade),) = occ.addThruSections(sections, makeSolid=True)
    occ.synchronize()
    groups: dict[str, list[int]] = {"root": [], "tip": [], "surface": []}
    for _, face in gmsh.model.getBoundary([(3, blade)], oriented=False):
        x = occ.getCenterOfMass(2, face)[0]
        end = "root" if x < 1e-6 * span else "tip" if x > (1 - 1e-6) * span else "surface"
        groups[end].append(face)
    for name, faces in groups.items():
        gmsh.model.addPhysicalGroup(2, faces, name=name)
    gmsh.model.addPhysicalGroup(3, [blade], name="blade")
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.MeshSizeMin", size)
    gmsh.model.mesh.generate(3)
