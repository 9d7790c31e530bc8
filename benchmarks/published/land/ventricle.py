"""The ventricle of Land et al. (2015): the wall between two ellipsoids of revolution around z, cut at z = 5 mm.

Cells are hexahedra of degree 2 whose nodes lie on ellipsoids with half-axes 7 + 3 t and 17 + 3 t mm, 0 ≤ t ≤ 1. Seen
along the axis, they fill a disc: a square in its middle, and rings around the square.

Groups: volume ``wall``; surfaces ``endo`` (t = 0), ``epi`` (t = 1), ``base``, and of a quarter ``x0`` and ``y0``.
"""

from __future__ import annotations

from itertools import pairwise, product
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hpcinv.base.quantity import Divisions

    Floats = npt.NDArray[np.float64]

HEXAHEDRON, QUADRILATERAL = 12, 10
"""gmsh's element types with 27 and 9 nodes."""
CORNER = 0.75
"""Half of the side of the square over the radius of the ring around it. Larger: flatter cells at its corners."""
ROUNDING = 3
"""Number of rings from the square to the first circle. Larger: smoother cells, and fewer circles."""


def build(
    gmsh: Any,
    *,
    across: Divisions = 2,
    around: Divisions = 8,
    along: Divisions = 8,
    apex: float = 0.5,
    base: float = 1.0,
    quarter: bool = True,
) -> None:
    """Mesh the wall, or a quarter of it.

    Args:
        across, around, along: cells through the wall, around the axis (a multiple of 8), and from apex to base.
        apex, base: size of the cells at the axis, and at the base, over the mean size along the wall.
    """
    to_axis, to_base = (1 + np.log2(1 / size) / np.log2(along) for size in (apex, base))
    distances = (1 - np.linspace(1, 0, along + 1) ** to_base) ** to_axis
    points: dict[tuple[int, ...], int] = {}
    cells: list[int] = []
    facets: dict[str, list[int]] = {}

    def tags(places: Floats) -> list[int]:
        return [
            points.setdefault(tuple(place), len(points) + 1) for place in np.rint(places * 1e9).astype(int).tolist()
        ]

    inner_nodes, face_nodes = _nodes(gmsh, HEXAHEDRON, 3), _nodes(gmsh, QUADRILATERAL, 2)
    for corners, (low, high) in product(_squares(around // 4, distances), pairwise(np.linspace(0, 1, across + 1))):
        if quarter and corners.mean(axis=(0, 1)).min() < 0:
            continue

        def places(local: Floats, corners: Floats = corners, low: float = low, high: float = high) -> Floats:
            a, b, c = local.T
            first, second = ((1 - b)[:, None] * edge[0] + b[:, None] * edge[1] for edge in corners)
            flat = _rounded((1 - a)[:, None] * first + a[:, None] * second, distances)
            return np.column_stack([flat, (1 - c) * low + c * high])

        cells += tags(places(inner_nodes))
        for axis, side in product(range(3), (0, 1)):
            face = places(np.insert(face_nodes, axis, side, axis=1))
            if name := _surface(face, quarter=quarter):
                facets.setdefault(name, []).extend(tags(face))

    gmsh.model.addDiscreteEntity(3, 1)
    gmsh.model.mesh.addNodes(3, 1, list(points.values()), _positions(np.array(list(points)) / 1e9).ravel())
    gmsh.model.mesh.addElementsByType(1, HEXAHEDRON, [], cells)
    gmsh.model.addPhysicalGroup(3, [1], name="wall")
    for number, (name, nodes) in enumerate(facets.items(), 1):
        gmsh.model.addDiscreteEntity(2, number)
        gmsh.model.mesh.addElementsByType(number, QUADRILATERAL, [], nodes)
        gmsh.model.addPhysicalGroup(2, [number], name=name)


def _nodes(gmsh: Any, element: int, dim: int) -> Floats:
    """Return the nodes of an element in [0, 1]^dim."""
    reference = gmsh.model.mesh.getElementProperties(element)[4]
    return (np.asarray(reference).reshape(-1, dim) + 1) / 2


def _squares(side: int, distances: Floats) -> Iterator[Floats]:
    """Yield the corners (2, 2, 2) of cells that fill [-1, 1]², in concentric square rings around a square grid."""
    grid = np.linspace(-1, 1, side + 1)
    for (a0, a1), (b0, b1) in product(pairwise(grid), repeat=2):
        yield distances[1] * np.array([[[a0, b0], [a0, b1]], [[a1, b0], [a1, b1]]])
    for turn, (inner, outer), (p0, p1) in product(range(4), pairwise(distances[1:]), pairwise(grid)):
        edges = np.array([[[r, r * p0], [r, r * p1]] for r in (inner, outer)])
        yield edges @ np.linalg.matrix_power(np.array([[0.0, 1.0], [-1.0, 0.0]]), turn)


def _rounded(flat: Floats, distances: Floats) -> Floats:
    """Map points of [-1, 1]² to the unit disc: the inner square stays one, rings become circles one by one."""
    size = np.abs(flat).max(axis=1, keepdims=True)
    direction = flat / np.where(size > 0, size, 1)
    turned = np.abs(direction[:, :1]) >= np.abs(direction[:, 1:])  # the angle is linear along each side of a ring
    p = np.where(turned, direction[:, 1:], direction[:, :1]) * np.pi / 4
    major = np.where(turned, direction[:, :1], direction[:, 1:])
    circle = np.hstack([np.where(turned, major * np.cos(p), np.sin(p)), np.where(turned, np.sin(p), major * np.cos(p))])
    last = min(ROUNDING + 1, len(distances) - 1)
    share = np.clip((size - distances[1]) / (distances[last] - distances[1]), 0, 1)
    rounded: Floats = size * ((1 - share) * CORNER * direction + share * circle)
    return rounded


def _positions(places: Floats) -> Floats:
    """Return the points (m) of places (x, y in the disc, t)."""
    disc, t = places[:, :2], places[:, 2]
    short, long = 0.007 + 0.003 * t, 0.017 + 0.003 * t
    distance = np.linalg.norm(disc, axis=1)
    angle = distance * (np.pi - np.arccos(0.005 / long))
    scale = short * np.where(distance > 0, np.sin(angle) / np.where(distance > 0, distance, 1), 0)
    return np.column_stack([scale[:, None] * disc, -long * np.cos(angle)])


def _surface(face: Floats, *, quarter: bool) -> str | None:
    """Return the name of the surface that the nodes of a facet lie on, if they do."""
    height = {"endo": face[:, 2], "epi": 1 - face[:, 2], "base": 1 - np.linalg.norm(face[:, :2], axis=1)}
    if quarter:
        height |= {"x0": face[:, 0], "y0": face[:, 1]}
    return next((name for name, distance in height.items() if np.abs(distance).max() < 1e-8), None)
