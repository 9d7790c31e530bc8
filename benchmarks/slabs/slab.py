"""Slabs of one cell's thickness made of rectangles, whose front and back (``z0``, ``z1``) keep them in plane strain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.base.quantity import Divisions, Length

type Line = Callable[[float, float], bool]


@dataclass(frozen=True)
class Outline:
    """Rectangles between the coordinates ``xs`` and ``ys`` (m) without the ``holes``, and conditions of its lines."""

    xs: tuple[float, ...]
    ys: tuple[float, ...]
    lines: dict[str, Line]
    holes: tuple[tuple[int, int], ...] = ()

    @property
    def rectangles(self) -> list[tuple[int, int]]:
        cells = [(i, j) for i in range(len(self.xs) - 1) for j in range(len(self.ys) - 1)]
        return [cell for cell in cells if cell not in self.holes]

    def singular_points(self, ends: tuple[tuple[float, float], ...]) -> list[tuple[float, float]]:
        """Return re-entrant corners, and the ``ends`` of supports."""
        corners = []
        for i in range(len(self.xs)):
            for j in range(len(self.ys)):
                quadrants = [(i - a, j - b) in self.rectangles for a in (0, 1) for b in (0, 1)]
                if sum(quadrants) == 3:
                    corners.append((self.xs[i], self.ys[j]))
        return [*corners, *ends]


OUTLINES = {
    "corner": Outline(
        (0, 1, 2), (0, 1, 2), {"left": lambda x, y: x == 0, "right": lambda x, y: x == 2}, holes=((1, 1),)
    ),
    "cantilever": Outline((0, 3), (0, 1), {"left": lambda x, y: x == 0, "right": lambda x, y: x == 3}),
    "slot": Outline(
        (0, 0.75, 1.25, 2),
        (0, 0.5, 1),
        {"left": lambda x, y: x == 0, "right": lambda x, y: x == 2},
        holes=((1, 1),),
    ),
    "pad": Outline(
        (0, 0.5, 1),
        (0, 0.5),
        {
            "bonded": lambda x, y: y == 0 and x < 0.5,
            "left": lambda x, y: x == 0,
            "right": lambda x, y: x == 1,
            "top": lambda x, y: y == 0.5,
        },
    ),
    "window": Outline(
        (0, 0.5, 1, 1.5),
        (0, 0.5, 1, 1.5),
        {"left": lambda x, y: x == 0, "bottom": lambda x, y: y == 0, "top": lambda x, y: y == 1.5},
        holes=((1, 1),),
    ),
    "step": Outline(
        (0, 1, 2), (0, 0.5, 1), {"left": lambda x, y: x == 0, "right": lambda x, y: x == 2}, holes=((1, 1),)
    ),
    "tee": Outline(
        (0, 0.75, 1.25, 2),
        (0, 0.5, 1.5),
        {"left": lambda x, y: x == 0, "right": lambda x, y: x == 2, "top": lambda x, y: y == 1.5},
        holes=((0, 1), (2, 1)),
    ),
    "zed": Outline(
        (0, 0.5, 1, 1.5),
        (0, 0.5, 1),
        {"left": lambda x, y: x == 0, "right": lambda x, y: x == 1.5},
        holes=((2, 0), (0, 1)),
    ),
    "cross": Outline(
        (0, 0.5, 1, 1.5),
        (0, 0.5, 1, 1.5),
        {"left": lambda x, y: x == 0, "right": lambda x, y: x == 1.5},
        holes=((0, 0), (2, 0), (0, 2), (2, 2)),
    ),
    "comb": Outline(
        (0, 0.5, 1, 1.5),
        (0, 0.5, 1),
        {"bottom": lambda x, y: y == 0, "right": lambda x, y: x == 1.5},
        holes=((1, 1),),
    ),
    "block": Outline((0, 1), (0, 1), {"bottom": lambda x, y: y == 0, "top": lambda x, y: y == 1}),
}


def build(
    gmsh: Any, *, shape: str = "corner", n: Divisions = 2, thickness: Length = 0.25, hexahedra: bool = False
) -> None:
    """Mesh a slab with ``2 n`` cells for each metre, and one through its thickness."""
    outline, geo = OUTLINES[shape], gmsh.model.geo
    points: dict[tuple[int, int], int] = {}
    lines: dict[tuple[tuple[int, int], tuple[int, int]], int] = {}

    def line(a: tuple[int, int], b: tuple[int, int]) -> int:
        if (b, a) in lines:
            return -lines[b, a]
        if (a, b) not in lines:
            for end in (a, b):
                if end not in points:
                    points[end] = geo.addPoint(outline.xs[end[0]], outline.ys[end[1]], 0)
            lines[a, b] = made = geo.addLine(points[a], points[b])
            length = abs(outline.xs[a[0]] - outline.xs[b[0]]) + abs(outline.ys[a[1]] - outline.ys[b[1]])
            geo.mesh.setTransfiniteCurve(made, max(1, round(2 * int(n) * length)) + 1)
        return lines[a, b]

    surfaces, loops = [], []
    for i, j in outline.rectangles:
        corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
        loop = [line(a, b) for a, b in pairwise([*corners, corners[0]])]
        surfaces.append(geo.addPlaneSurface([geo.addCurveLoop(loop)]))
        geo.mesh.setTransfiniteSurface(surfaces[-1], cornerTags=[points[c] for c in corners])
        if hexahedra:
            geo.mesh.setRecombine(2, surfaces[-1])
        loops.append([(abs(tag), a, b) for tag, (a, b) in zip(loop, pairwise([*corners, corners[0]]), strict=True)])
    made = geo.extrude([(2, s) for s in surfaces], 0, 0, thickness, [1], recombine=hexahedra)
    geo.synchronize()
    groups: dict[str, list[int]] = {"z0": surfaces, "z1": [tag for _, tag in made[::6]]}
    for number, edges in enumerate(loops):
        for (_, a, b), (_, side) in zip(edges, made[6 * number + 2 : 6 * number + 6], strict=True):
            x, y = ((c[k] + c[m]) / 2 for c, k, m in ((outline.xs, a[0], b[0]), (outline.ys, a[1], b[1])))
            for name, is_on in outline.lines.items():
                if is_on(x, y):
                    groups.setdefault(name, []).append(side)
    for name, members in groups.items():
        gmsh.model.addPhysicalGroup(2, members, name=name)
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in made[1::6]], name="body")
    gmsh.model.mesh.generate(3)
