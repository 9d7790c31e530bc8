"""The unit cube in 5 or 28 tetrahedra, with the groups ``cube`` and ``x0``, ``x1``, ``y0``, ``y1``, ``z0``, ``z1``.

Five: one cell in the middle, on every other corner of the cube, and four at the other corners. Twenty-eight: twelve
cells on the edges of the cube, eight at its corners and eight about its centre, all with the centres of the faces.
"""

from __future__ import annotations

from itertools import combinations, product
from typing import Any

TRIANGLE, TETRAHEDRON = 2, 4  # gmsh's numbers

type Point = tuple[float, float, float]
CORNERS: list[Point] = [(float(x), float(y), float(z)) for x, y, z in product((0, 1), repeat=3)]


def build(gmsh: Any, *, centres: bool = True) -> None:
    """Mesh the cube [0, 1]³ m in 28 cells with the ``centres`` of its faces, or in 5 cells."""
    cells = [_right_handed(cell) for cell in (_twenty_eight() if centres else _five())]
    numbers = {point: number for number, point in enumerate(sorted({p for cell in cells for p in cell}), 1)}
    mesh = gmsh.model.mesh
    cube = gmsh.model.addDiscreteEntity(3)
    mesh.addNodes(3, cube, list(numbers.values()), [x for point in numbers for x in point])
    mesh.addElementsByType(cube, TETRAHEDRON, [], [numbers[point] for cell in cells for point in cell])
    gmsh.model.addPhysicalGroup(3, [cube], name="cube")
    facets = [facet for cell in cells for facet in combinations(cell, 3)]
    for axis, side in product(range(3), (0, 1)):
        face = gmsh.model.addDiscreteEntity(2)
        corners = [numbers[p] for facet in facets if all(p[axis] == side for p in facet) for p in facet]
        mesh.addElementsByType(face, TRIANGLE, [], corners)
        gmsh.model.addPhysicalGroup(2, [face], name=f"{'xyz'[axis]}{side}")


def _five() -> list[tuple[Point, ...]]:
    even = [corner for corner in CORNERS if sum(corner) % 2 == 0]
    return [tuple(even)] + [
        (corner, *(other for other in even if _distance(corner, other) == 1))
        for corner in CORNERS
        if corner not in even
    ]


def _twenty_eight() -> list[tuple[Point, ...]]:
    def centres(corner: Point, axes: list[int]) -> list[Point]:
        return [tuple(corner[i] if i == axis else 0.5 for i in range(3)) for axis in axes]  # type: ignore[misc]

    cells = [(apex, *centres(corner, [0, 1, 2])) for corner in CORNERS for apex in (corner, (0.5, 0.5, 0.5))]
    for first, second in combinations(CORNERS, 2):
        if _distance(first, second) == 1:
            cells.append((first, second, *centres(first, [i for i in range(3) if first[i] == second[i]])))
    return cells


def _distance(first: Point, second: Point) -> float:
    """Return the number of edges between two corners."""
    return sum(abs(p - q) for p, q in zip(first, second, strict=True))


def _right_handed(cell: tuple[Point, ...]) -> tuple[Point, ...]:
    """Return the corners of a cell in an order of positive volume."""
    (a, b, c), (d, e, f), (g, h, i) = ([p - q for p, q in zip(point, cell[0], strict=True)] for point in cell[1:])
    volume = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return cell if volume > 0 else (cell[1], cell[0], *cell[2:])
