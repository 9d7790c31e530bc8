"""Left ventricle as a truncated half-ellipsoid of revolution around z, apex downwards, of tetrahedra.

Groups: volume ``wall``; surfaces ``endo`` (the cavity), ``epi`` (outside) and ``base`` (z = ``base``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Length, Size


def build(
    gmsh: Any,
    *,
    radius: Length = 0.025,
    length: Length = 0.06,
    wall: Length = 0.01,
    base: Length = 0.015,
    size: Size = 0.006,
) -> None:
    """Mesh a ``wall`` around an ellipsoid of half-axes ``radius`` and ``length``, below z = ``base``."""
    occ, solids = gmsh.model.occ, list[tuple[int, int]]()
    for r, h in ((radius + wall, length + wall), (radius, length)):
        ball = occ.addSphere(0, 0, 0, r)
        occ.dilate([(3, ball)], 0, 0, 0, 1, 1, h / r)
        solids.append((3, ball))
    shell, _ = occ.cut(solids[:1], solids[1:])
    reach = length + 2 * wall
    above = occ.addBox(-reach, -reach, base, 2 * reach, 2 * reach, 2 * reach)
    body, _ = occ.cut(shell, [(3, above)])
    occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in body], name="wall")
    groups: dict[str, list[int]] = {"endo": [], "epi": [], "base": []}
    for dim, tag in gmsh.model.getBoundary(body, oriented=False):
        low, high = gmsh.model.getBoundingBox(dim, tag)[2::3]
        deep = low < -(length + wall / 2)
        groups["base" if high - low < wall / 10 else "epi" if deep else "endo"].append(tag)
    for name, tags in groups.items():
        gmsh.model.addPhysicalGroup(2, tags, name=name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.MeshSizeMin", size)
    gmsh.model.mesh.generate(3)
