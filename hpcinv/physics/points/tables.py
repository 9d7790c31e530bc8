"""Values of basis functions at points of the reference cell or of its facets, as programs take them."""

from __future__ import annotations

from typing import Any

import basix
import numpy as np

from hpcinv.physics.points.program import Doubles, lanes_of
from hpcinv.physics.points.scalar_graph import NotAnalytic


class Tables:
    """Tables at the points of one rule, which fill whole blocks; the points that fill up the last repeat its last one.

    Args:
        points: of the reference cell (n, 3), or of each of its facets (facets, n, 3).
        weights: of the points (n,), per volume of the cell or per area of the reference facet; ``None`` without.
        normals: outward normals of the facets of the reference cell (facets, 3), times their areas in integrals.
    """

    def __init__(self, points: Doubles, weights: Doubles | None = None, normals: Doubles | None = None) -> None:
        self.count = points.shape[-2]
        self.lanes = lanes_of(self.count)
        self.blocks = -(-self.count // self.lanes)
        self._points = points.reshape(-1, self.count, 3)
        self._weights, self._normals = weights, normals
        self._known: dict[Any, tuple[int, int]] = {}
        self._parts: list[Doubles] = []
        self._size = 0

    def functions(self, element: Any, direction: int) -> tuple[int, int]:
        """Return table and number of the basis functions of a scalar element, or of their derivatives."""
        key = element, direction
        if key not in self._known:
            order = int(direction >= 0)
            self._add(
                key, np.stack([self._tabulated(element, points, order)[direction + 1] for points in self._points])
            )
        return self._known[key]

    def normal(self, i: int) -> int:
        """Return the table of a component of the normal of the facet of the reference cell."""
        if self._normals is None:
            raise NotAnalytic("it has the normal of a facet inside the body")
        key = "normal", i
        if key not in self._known:
            self._add(key, np.repeat(self._normals[:, i, None, None], self.count, axis=1))
        return self._known[key][0]

    @property
    def weight(self) -> int:
        """Table of the weights; the points that fill up have none."""
        key = "weight"
        if key not in self._known:
            if self._weights is None:
                raise NotAnalytic("it has the weight of a point outside an integral")
            weights = np.repeat(self._weights[None, :, None], len(self._points), axis=0)
            self._add(key, weights, filled=False)
        return self._known[key][0]

    def array(self) -> tuple[Doubles, int]:
        """Return all tables (entities, functions, padded points), and the size of a part of one facet; 0 for cells."""
        empty = np.zeros((len(self._points), 0, self.lanes * self.blocks))
        array = np.ascontiguousarray(np.concatenate([empty, *self._parts], axis=1))
        return array, (array[0].size if len(self._points) > 1 else 0)

    def _tabulated(self, element: Any, points: Doubles, order: int) -> Doubles:
        if element.is_quadrature:
            own = element.custom_quadrature()[0]
            if order or own.shape != points.shape or not np.allclose(own, points):
                raise NotAnalytic("it has a function that is not known at its points")
        table: Doubles = np.asarray(element.tabulate(order, points))
        return table

    def _add(self, key: Any, values: Doubles, *, filled: bool = True) -> None:
        """Add a table (entities, points, functions)."""
        table = np.zeros((len(values), values.shape[2], self.lanes * self.blocks))
        table[:, :, : self.count] = values.transpose(0, 2, 1)
        if filled:
            table[:, :, self.count :] = table[:, :, self.count - 1, None]
        self._known[key] = self._size, table.shape[1]
        self._size += table.shape[1]
        self._parts.append(table)


def cell_rule(kind: str, metadata: Any) -> tuple[Doubles, Doubles]:
    """Return points (n, 3) and weights (n,) of an integral over cells; raise ``NotAnalytic`` for unknown rules."""
    if metadata.get("quadrature_rule") == "custom":
        return np.array(metadata["quadrature_points"]), np.array(metadata["quadrature_weights"])
    points, weights = basix.make_quadrature(basix.CellType[kind], degree_of(metadata))
    return points, weights


def facet_rule(kind: str, metadata: Any) -> tuple[Doubles, Doubles, Doubles]:
    """Return points (facets, n, 3) and weights (n,) of an integral over facets, and normals times areas (facets, 3)."""
    facet = basix.cell.subentity_types(basix.CellType[kind])[2][0]
    points, weights = basix.make_quadrature(facet, degree_of(metadata))
    places, normals = on_facets(kind, points)
    return places, weights, normals


def on_facets(kind: str, points: Doubles) -> tuple[Doubles, Doubles]:
    """Return points (n, 2) of the reference facet on each facet (facets, n, 3), and normals times areas (facets, 3)."""
    cell = basix.CellType[kind]
    corners, normals = basix.geometry(cell), basix.cell.facet_outward_normals(cell)
    places, areas = [], []
    for vertices in basix.topology(cell)[2]:
        origin, *ends = corners[vertices[:3]]
        axes = np.stack(ends) - origin
        places.append(origin + points @ axes)
        areas.append(np.linalg.norm(np.cross(*axes)))
    return np.stack(places), normals * np.array(areas)[:, None]


def degree_of(metadata: Any) -> int:
    degree, rule = metadata.get("quadrature_degree"), metadata.get("quadrature_rule", "default")
    if not isinstance(degree, int) or rule != "default":
        raise NotAnalytic(f"its quadrature is '{rule}' of degree '{degree}'")
    return int(degree)
