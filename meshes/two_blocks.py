"""Two blocks, one above the other, whose meshes share no node, of tetrahedra or hexahedra.

Groups: volumes ``lower``, ``upper``; surfaces ``top`` of the lower block and ``bottom`` of the upper one, which face
each other, and ``x0``, ``x1``, ``y0``, ``y1``, ``z0``, ``z1`` around both.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from hpcinv.base.quantity import Divisions, Length


def build(
    gmsh: Any,
    *,
    lx: Length = 1.0,
    ly: Length = 1.0,
    lower_height: Length = 0.5,
    upper_height: Length = 0.5,
    gap: Length = 0.0,
    lower: Divisions = 2,
    upper: Divisions = 3,
    layers: Divisions = 1,
    across: Divisions = 0,
    hexahedra: bool = False,
    margin: Length = 0.0,
    crown: Length = 0.0,
    cylinder: bool = False,
    focus: float = 1.0,
) -> None:
    """Mesh each block with its own number of divisions along x and y, and both with ``layers`` of cells.

    Args:
        across: divisions of both along y, if they are not those along x.
        margin: by which the lower block is longer than the upper one along x and y.
        crown: height by which the lower face of the upper block rises from x = y = 0 to the far corner, as a
            paraboloid; its upper face stays flat.
        cylinder: whether it rises along x alone.
        focus: size of the cells at the line x = y = 0, and at the surfaces that face each other, by the size of equal
            cells.
    """
    start = lower_height + gap
    wide = (lx + margin, ly + margin)
    below = _block(gmsh, wide, (0.0, lower_height), (int(lower), int(across or lower), int(layers)), hexahedra)
    above = _block(gmsh, (lx, ly), (start, upper_height), (int(upper), int(across or upper), int(layers)), hexahedra)
    for name in ("x0", "x1", "y0", "y1"):
        gmsh.model.addPhysicalGroup(2, [below[name], above[name]], name=name)
    for name, surface in (("z0", below["z0"]), ("top", below["z1"]), ("bottom", above["z0"]), ("z1", above["z1"])):
        gmsh.model.addPhysicalGroup(2, [surface], name=name)
    for name, block in (("lower", below), ("upper", above)):
        gmsh.model.addPhysicalGroup(3, [block["volume"]], name=name)
    gmsh.model.mesh.generate(3)
    if focus != 1.0:
        _focus(gmsh, below["volume"], wide, (lower_height, lower_height), focus)
        _focus(gmsh, above["volume"], (lx, ly), (start, upper_height), focus)
    if crown:
        along_y = 0.0 if cylinder else 1.0
        rise = crown / (lx**2 + along_y * ly**2)
        top = start + upper_height
        _move(
            gmsh,
            above["volume"],
            lambda x, y, z: (x, y, z + (top - z) / upper_height * rise * (x**2 + along_y * y**2)),
        )


def _block(
    gmsh: Any, sides: tuple[float, float], heights: tuple[float, float], divisions: tuple[int, ...], hexahedra: bool
) -> dict[str, int]:
    """Make a block from a place z on, of a height; return its surfaces, and its volume, by name."""
    sizes, low = (*sides, heights[1]), (0.0, 0.0, heights[0])
    volume = gmsh.model.occ.addBox(*low, *sizes)
    gmsh.model.occ.synchronize()
    named = {"volume": volume}
    for _, surface in gmsh.model.getBoundary([(3, volume)], oriented=False):
        box = gmsh.model.getBoundingBox(2, surface)
        axis = min(range(3), key=lambda i: box[3 + i] - box[i])
        is_far = box[axis] - low[axis] > sizes[axis] / 2
        named[f"{'xyz'[axis]}{int(is_far)}"] = surface
        for _, edge in gmsh.model.getBoundary([(2, surface)], oriented=False):
            ends = gmsh.model.getBoundingBox(1, edge)
            along = max(range(3), key=lambda i: ends[3 + i] - ends[i])
            gmsh.model.mesh.setTransfiniteCurve(edge, divisions[along] + 1)
        gmsh.model.mesh.setTransfiniteSurface(surface)
        if hexahedra:
            gmsh.model.mesh.setRecombine(2, surface)
    gmsh.model.mesh.setTransfiniteVolume(volume)
    return named


def _focus(gmsh: Any, volume: int, sides: tuple[float, float], face: tuple[float, float], size: float) -> None:
    """Move nodes towards x = y = 0, and towards a face; ``face`` has its z and the height of the block."""
    (lx, ly), (at, height) = sides, face

    def near(share: float) -> float:
        return share * (size + (1 - size) * abs(share) ** 7)

    def moved(x: float, y: float, z: float) -> tuple[float, float, float]:
        return lx * near(x / lx), ly * near(y / ly), at + height * near((z - at) / height)

    _move(gmsh, volume, moved)


def _move(gmsh: Any, volume: int, moved: Callable[[float, float, float], tuple[float, float, float]]) -> None:
    """Move the nodes of a volume and of its boundary."""
    nodes, places, _ = gmsh.model.mesh.getNodes(3, volume, includeBoundary=True)
    for node, place in zip(nodes, places.reshape(-1, 3), strict=True):
        gmsh.model.mesh.setNode(node, list(moved(*place)), [])
